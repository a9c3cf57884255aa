"""A point cloud of which each point has a class, and perhaps an instance."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.errors import DatasetError
from logs.records import frozen

_PREFIX = "scalar_"
"""CloudCompare puts it before the names of fields."""

CLASS_FIELDS = ("class", "class_id", "classification", "semantic", "semantic_label", "label", "category")
INSTANCE_FIELDS = ("instance", "instance_id", "instance_label", "object_id", "object", "id", "label")
"""Names of the fields that hold a point's class and instance, likeliest first: a "label" is the class, unless another
field is that. So they are in Paris-Lille-3D ("class", "label"; Roynard et al., IJRR 2018) and in IQmulus &
TerraMobilita ("class", "id"; Vallet et al., Computers & Graphics 2015)."""


@frozen
class LabelledCloud:
    """positions (N, 3) m; classes (N,); instances (N,), 0: none, or None where the cloud tells no instances.

    Raises:
        DatasetError: numbers of positions, classes and instances that differ.
    """

    positions: NDArray[np.float64]
    classes: NDArray[np.int64]
    instances: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        counts = [len(each) for each in (self.positions, self.classes, self.instances) if each is not None]
        if len(set(counts)) != 1 or self.positions.shape[1:] != (3,):
            raise DatasetError(
                f"a cloud of {counts[0]} points has {', '.join(map(str, counts[1:]))} labels; give one for each point"
            )

    def finite(self) -> "LabelledCloud":
        """The cloud without the points that have NaN or Inf: beams that hit nothing."""
        is_finite = np.isfinite(self.positions).all(axis=1)
        instances = self.instances[is_finite] if self.instances is not None else None
        return LabelledCloud(self.positions[is_finite], self.classes[is_finite], instances)


def labelled_cloud(columns: Mapping[str, NDArray[Any]]) -> LabelledCloud:
    """The cloud of ``columns``, name -> values (N,).

    Where no field tells instances and the classes are those of SemanticKITTI with the instance in their upper half,
    they are taken apart.

    Raises:
        DatasetError: no positions or classes; names the fields.
    """
    plain = {key.lower().removeprefix(_PREFIX): values for key, values in columns.items()}
    there = ", ".join(columns) or "none"
    if not {"x", "y", "z"} <= plain.keys():
        raise DatasetError(f"cloud: no fields x, y and z; it has {there}")
    class_field = next((field for field in CLASS_FIELDS if field in plain), None)
    if class_field is None:
        raise DatasetError(f"cloud: no field holds the class of a point ({' or '.join(CLASS_FIELDS)}); it has {there}")
    positions = np.stack([plain[axis].astype(np.float64) for axis in "xyz"], axis=1)
    classes = _whole(plain[class_field], class_field)
    instance_field = next((field for field in INSTANCE_FIELDS if field in plain and field != class_field), None)
    instances = None
    if instance_field is not None:
        instances = _whole(plain[instance_field], instance_field)
    elif class_field == "label" and classes.max(initial=0) > 0xFFFF:
        classes, instances = classes & 0xFFFF, classes >> 16
    return LabelledCloud(positions, classes, instances)


def _whole(values: NDArray[Any], name: str) -> NDArray[np.int64]:
    if values.dtype.kind == "f" and not (np.isfinite(values) & (values == np.round(values))).all():
        raise DatasetError(f"cloud: field {name} holds fractions, which cannot be labels; rename the field")
    return values.astype(np.int64)
