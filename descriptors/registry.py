"""Which descriptors there are, and the index that each is looked up in."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

from descriptors.baselines.gosmatch import GosmatchGraph, GosmatchVertex
from descriptors.baselines.onion import Onion, OnionHistogram
from descriptors.baselines.random_walk import RandomWalk
from descriptors.descriptellation_lr.learned_likelihood import LearnedLikelihood, is_learned_likelihood
from descriptors.descriptor import Descriptor
from descriptors.errors import DescriptorError
from descriptors.index import ConstellationIndex, VectorIndex
from descriptors.likelihood_index import LikelihoodIndex
from descriptors.random_vector import RandomVector
from descriptors.ring_likelihood import RingLikelihood

HANDCRAFTED: dict[str, Callable[[], Descriptor]] = {
    "onion": Onion,
    "onion_histogram": OnionHistogram,
    "random_walk": RandomWalk,
    "gosmatch_graph": GosmatchGraph,
    "gosmatch_vertex": GosmatchVertex,
}
SHIPPED = Path(__file__).parent / "weights"
PAPER = "descriptellation"
NETWORKS = (PAPER, "pointnet", "sgnet")
LEARNED = (LearnedLikelihood.name, *NETWORKS)
DESCRIPTOR_NAMES = (RingLikelihood.name, *LEARNED, *HANDCRAFTED, RandomVector.name)
RENAMED = {"descriptellation_paper": "descriptellation"}
"""Names of earlier versions."""
WEIGHTS_SUFFIX = ".safetensors"


def make_descriptor(name: str) -> Descriptor:
    """A descriptor: one of :data:`DESCRIPTOR_NAMES`, a file of weights, or a class of one's own as ``module:Class``.

    A class of one's own is imported and made without arguments; it does what :class:`Descriptor` says.

    Raises:
        DescriptorError: there is none of that name, weights that do not fit, or a class that cannot be made.
    """
    if name == RingLikelihood.name:
        return RingLikelihood()
    if name == RandomVector.name:
        return RandomVector()
    if name in HANDCRAFTED:
        return HANDCRAFTED[name]()
    if name in LEARNED:
        return _from_weights(SHIPPED / f"{name}{WEIGHTS_SUFFIX}")
    if name.endswith(WEIGHTS_SUFFIX):
        return _from_weights(Path(name))
    if ":" in name:
        return _from_class(name)
    if name in RENAMED:
        raise DescriptorError(f"no descriptor {name!r}; it is called {RENAMED[name]!r} now")
    raise DescriptorError(
        f"no descriptor {name!r}; there are {', '.join(DESCRIPTOR_NAMES)}, weights by their path "
        f"(NAME{WEIGHTS_SUFFIX}), and classes of your own (module:Class)"
    )


def make_index(name: str) -> ConstellationIndex:
    """An empty index for constellations, with that descriptor.

    Raises:
        DescriptorError: as :func:`make_descriptor`.
    """
    descriptor = make_descriptor(name)
    if isinstance(descriptor, RingLikelihood | LearnedLikelihood):
        return LikelihoodIndex(descriptor)
    if descriptor.name == PAPER:
        from descriptors.learned.network_descriptor import LearnedDescriptor  # loads torch
        from descriptors.learned.paper_index import PaperIndex

        if isinstance(descriptor, LearnedDescriptor):
            return PaperIndex(descriptor)
    return VectorIndex(descriptor)


def _from_weights(path: Path) -> Descriptor:
    if is_learned_likelihood(path):
        return LearnedLikelihood(path)
    from descriptors.learned.network_descriptor import LearnedDescriptor  # loads torch

    return LearnedDescriptor(path)


def _from_class(name: str) -> Descriptor:
    module, _, attribute = name.partition(":")
    try:
        made = getattr(importlib.import_module(module), attribute)()
    except Exception as error:  # whatever the user's code raises
        raise DescriptorError(f"{name}: cannot be made: {type(error).__name__}: {error}") from error
    lacking = [part for part in ("name", "radius_m", "describe") if not hasattr(made, part)]
    if lacking:
        raise DescriptorError(
            f"{name}: is no descriptor, it lacks {', '.join(lacking)}; see descriptors.descriptor.Descriptor"
        )
    descriptor: Descriptor = made
    return descriptor
