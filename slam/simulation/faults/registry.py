"""The faults by their names, with their parameters and their meaning."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from logs.topics import RecordKind
from slam.common.errors import ConfigurationError
from slam.simulation.faults import clocks, labels, lengths, objects, odometry, positions
from slam.simulation.faults.stream import Entry

_ODOMETRY = (RecordKind.ODOMETRY,)
_SCANS = (RecordKind.DETECTIONS, RecordKind.DETECTION_TRUTH)
_DETECTIONS = (RecordKind.DETECTIONS,)
_ALL = (*_ODOMETRY, *_DETECTIONS, RecordKind.TRANSFORMS, RecordKind.GROUND_TRUTH, RecordKind.OBJECT_TRUTH)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number that a fault takes, in [least, most]."""

    name: str
    default: float
    least: float = 0.0
    most: float = math.inf
    is_whole: bool = False


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of fault.

    ``function`` takes a stream, a generator, and a number for each of the ``parameters``. ``changes``: kinds of records
    that may differ after it; ``reads``: others that it looks at. ``cases``: values by which it is measured.
    """

    name: str
    meaning: str
    function: Callable[..., list[Entry]]
    changes: tuple[RecordKind, ...]
    parameters: tuple[Parameter, ...] = ()
    reads: tuple[RecordKind, ...] = ()
    cases: tuple[str, ...] = ("",)

    @property
    def usage(self) -> str:
        """How it is written, with its defaults: "gyro_bias=3:10"."""
        return FaultCase(self, tuple(p.default for p in self.parameters)).name


@dataclass(frozen=True, slots=True)
class FaultCase:
    """A fault with a value for each of its parameters."""

    fault: Fault
    values: tuple[float, ...]

    @property
    def name(self) -> str:
        """The same for two that do the same, and what :func:`parse_fault` reads."""
        told = ":".join(f"{value:g}" for value in self.values)
        return f"{self.fault.name}={told}" if told else self.fault.name


_START = Parameter("part of the drive", 0.5, most=1.0)


def _seconds(default: float) -> Parameter:
    return Parameter("s", default, most=1e6)


def _degrees(default: float) -> Parameter:
    return Parameter("deg", default, least=-360.0, most=360.0)


def _factor(default: float) -> Parameter:
    return Parameter("factor", default, most=1e3)


def _metres(default: float) -> Parameter:
    return Parameter("m", default, least=-1e6, most=1e6)


def _hertz(default: float) -> Parameter:
    return Parameter("Hz", default, least=1e-3, most=1e3)


def _number(default: float) -> Parameter:
    return Parameter("number", default, least=1.0, most=1e6, is_whole=True)


_OF_ODOMETRY = (
    Fault(
        "heading_jump",
        "the heading of the odometry jumps by DEG at once, at a part of the drive",
        odometry.jump_heading,
        _ODOMETRY,
        (_degrees(30.0), _START),
        cases=("5", "30", "90", "180"),
    ),
    Fault("pitch_jump", "its pitch jumps by DEG at half time", odometry.jump_pitch, _ODOMETRY, (_degrees(20.0),)),
    Fault(
        "odometry_jumps",
        "NUMBER jumps of M, evenly over the drive",
        odometry.jump_position,
        _ODOMETRY,
        (_number(10.0), _metres(1.5)),
        cases=("10:1.5", "1:50"),
    ),
    Fault("odometry_wild", "one message is M away at half time", odometry.send_wild, _ODOMETRY, (_metres(1000.0),)),
    Fault(
        "odometry_frozen",
        "one pose is repeated from a part of the drive on",
        odometry.freeze_from,
        _ODOMETRY,
        (_START,),
    ),
    Fault(
        "odometry_freezes",
        "it stands still for S from half time on, then goes on from there",
        odometry.freeze_for,
        _ODOMETRY,
        (_seconds(10.0),),
    ),
    Fault(
        "odometry_pause",
        "no odometry for S from half time on",
        clocks.pause_odometry,
        _ODOMETRY,
        (_seconds(10.0),),
    ),
    Fault(
        "odometry_backwards",
        "its stamps fall instead of rising for S from half time on",
        clocks.run_backwards,
        _ODOMETRY,
        (_seconds(10.0),),
    ),
    Fault("odometry_scale", "its travel is multiplied", odometry.scale_travel, _ODOMETRY, (_factor(1.2),)),
    Fault("odometry_turns", "its turns are multiplied", odometry.scale_turns, _ODOMETRY, (_factor(1.1),)),
    Fault("odometry_yaw_inverted", "its heading turns the other way", odometry.invert_yaw, _ODOMETRY),
    Fault(
        "gyro_bias",
        "its heading turns by DEG/S too much for S from half time on",
        odometry.bias_gyroscope,
        _ODOMETRY,
        (Parameter("deg/s", 3.0, least=-1e4, most=1e4), _seconds(10.0)),
        cases=("3:10", "30:1"),
    ),
    Fault(
        "wheel_slip",
        "its travel is multiplied for S from half time on",
        odometry.slip,
        _ODOMETRY,
        (_factor(1.5), _seconds(5.0)),
        cases=("1.5:5", "0.5:5"),
    ),
    Fault("odometry_restart", "its poses begin again at the origin at half time", odometry.start_over, _ODOMETRY),
    Fault(
        "heading_drift",
        "its heading drifts at random, by DEG rms after 100 m",
        odometry.drift_heading,
        _ODOMETRY,
        (Parameter("deg", 10.0, most=360.0),),
    ),
    Fault("odometry_z_down", "odometry and body have z down, the detections not", odometry.point_z_down, _ODOMETRY),
    Fault(
        "odometry_interleaved",
        "a second odometry on the same topic, its origin M aside",
        odometry.interleave,
        _ODOMETRY,
        (_metres(1.0),),
    ),
    Fault(
        "odometry_noise",
        "its errors against the truth are multiplied",
        odometry.scale_odometry_noise,
        _ODOMETRY,
        (_factor(3.0),),
        reads=(RecordKind.GROUND_TRUTH,),
        cases=("0.3", "3", "10"),
    ),
)

_OF_CLOCKS = (
    Fault(
        "detections_late",
        "detections are stamped S too late",
        clocks.stamp_late,
        _SCANS,
        (_seconds(0.1),),
        cases=("0.05", "0.1", "0.5", "2"),
    ),
    Fault(
        "detections_early",
        "detections are stamped S too early",
        clocks.stamp_early,
        _SCANS,
        (_seconds(0.5),),
        cases=("0.1", "0.5"),
    ),
    Fault(
        "detections_clock_back",
        "the clock of the detections is S behind from half time on",
        clocks.set_clock_back,
        _SCANS,
        (_seconds(30.0),),
    ),
    Fault(
        "odometry_clock_back",
        "the clock of the odometry is S behind from half time on",
        clocks.set_odometry_clock_back,
        _ODOMETRY,
        (_seconds(30.0),),
    ),
    Fault(
        "detections_clock_slow",
        "the clock of the detections is slow by so many parts in a million",
        clocks.run_slow,
        _SCANS,
        (Parameter("ppm", 200.0, least=-1e6, most=1e6),),
    ),
    Fault(
        "stamps_coarse",
        "stamps of detections are cut to multiples of S",
        clocks.stamp_coarsely,
        _SCANS,
        (_seconds(1.0),),
    ),
    Fault(
        "log_gap",
        "neither odometry nor detections for S from half time on",
        clocks.pause_all,
        (*_ODOMETRY, *_SCANS),
        (_seconds(10.0),),
    ),
    Fault("messages_twice", "each message comes twice", clocks.send_twice, (*_ODOMETRY, *_DETECTIONS)),
    Fault("stamps_in_microseconds", "stamps of detections are in microseconds", clocks.stamp_in_microseconds, _SCANS),
    Fault("scan_rate", "detections come at HZ at most", clocks.thin_scans, _SCANS, (_hertz(1.0),), cases=("1", "0.5")),
    Fault(
        "frame_rate",
        "odometry and detections come at HZ, thinned or filled in",
        clocks.change_rate,
        (*_ODOMETRY, *_SCANS),
        (_hertz(1.0),),
        cases=("1", "100"),
    ),
)

_OF_POSITIONS = (
    Fault(
        "position_noise",
        "positions have M of noise on each axis that no covariance tells",
        positions.add_noise,
        _DETECTIONS,
        (Parameter("m", 1.0, most=1e3),),
    ),
    Fault(
        "claimed_sigma",
        "all covariances say M on each axis",
        positions.claim_sigma,
        _DETECTIONS,
        (Parameter("m", 1e-3, least=1e-9, most=1e3),),
    ),
    Fault(
        "detection_noise",
        "errors of positions against the truth are multiplied",
        positions.scale_detection_noise,
        _DETECTIONS,
        (_factor(3.0),),
        reads=(*_ODOMETRY, *_SCANS, RecordKind.GROUND_TRUTH, RecordKind.OBJECT_TRUTH, RecordKind.TRANSFORMS),
        cases=("0.5", "3"),
    ),
    Fault(
        "one_point",
        "all objects are seen M ahead of the sensor",
        positions.see_at_one_point,
        _DETECTIONS,
        (_metres(5.0),),
    ),
    Fault(
        "height_offset",
        "all objects are seen M too high",
        positions.shift_heights,
        _DETECTIONS,
        (_metres(2.0),),
        reads=(*_ODOMETRY, RecordKind.TRANSFORMS),
    ),
    Fault(
        "odometry_frame",
        "positions are in the frame of the odometry, and are told to be in the sensor's",
        positions.place_in_odometry_frame,
        _DETECTIONS,
        reads=(*_ODOMETRY, RecordKind.TRANSFORMS),
    ),
    Fault("sensor_upside_down", "the sensor hangs upside down, untold", positions.turn_upside_down, _DETECTIONS),
    Fault(
        "sensor_yaw",
        "the sensor is turned by DEG about its z axis, untold",
        positions.turn_sensor,
        _DETECTIONS,
        (_degrees(10.0),),
        cases=("10", "90"),
    ),
    Fault(
        "ranges_scaled",
        "all objects are seen farther by a factor",
        positions.scale_ranges,
        _DETECTIONS,
        (_factor(1.1),),
    ),
    Fault(
        "sensor_mirrored",
        "left and right of the sensor are exchanged for S from half time on",
        positions.mirror,
        _DETECTIONS,
        (_seconds(20.0),),
        reads=_ODOMETRY,
    ),
    Fault(
        "sensor_optical",
        "positions in optical axes (x right, y down, z forward), untold",
        positions.see_in_optical_axes,
        _DETECTIONS,
    ),
)

_OF_OBJECTS = (
    Fault("labels_random", "each detection has a label taken at random", labels.draw_labels, _DETECTIONS),
    Fault("labels_unique", "each detection has a label of its own", labels.number_labels, _DETECTIONS),
    Fault("labels_one_class", "all detections have one label", labels.use_one_label, _DETECTIONS),
    Fault("labels_case", "labels are in capitals from half time on", labels.change_case, _DETECTIONS, reads=_ODOMETRY),
    Fault(
        "labels_permuted",
        "from half time on each label means another one's objects",
        labels.permute_labels,
        _DETECTIONS,
        reads=_ODOMETRY,
    ),
    Fault(
        "detections_stop",
        "no detections from a part of the drive on",
        objects.stop_detecting,
        _SCANS,
        (_START,),
        reads=_ODOMETRY,
    ),
    Fault(
        "scan_repeated",
        "the last scan before half time is repeated for S",
        objects.repeat_scan,
        _SCANS,
        (_seconds(10.0),),
        reads=_ODOMETRY,
    ),
    Fault(
        "objects_burst",
        "NUMBER more objects stand around for S from half time on",
        objects.burst,
        _SCANS,
        (_number(5000.0), _seconds(3.0)),
        reads=(*_ODOMETRY, RecordKind.TRANSFORMS),
    ),
    Fault("objects_few", "only NUMBER objects are there", objects.keep_objects, _SCANS, (_number(2.0),)),
    Fault(
        "objects_moving",
        "a share of the objects moves by M/S",
        objects.move_objects,
        _DETECTIONS,
        (Parameter("share", 0.5, most=1.0), Parameter("m/s", 2.0, most=1e3)),
        reads=(*_ODOMETRY, RecordKind.DETECTION_TRUTH, RecordKind.TRANSFORMS),
    ),
    Fault(
        "lengths_scaled",
        "all lengths of the log and of its truth are multiplied",
        lengths.scale_lengths,
        _ALL,
        (Parameter("factor", 0.05, least=1e-6, most=1e6),),
        cases=("0.05", "20"),
    ),
)

FAULTS = {fault.name: fault for fault in (*_OF_ODOMETRY, *_OF_CLOCKS, *_OF_POSITIONS, *_OF_OBJECTS)}


def parse_fault(text: str) -> FaultCase:
    """A fault as it is typed: NAME, or NAME=VALUE with the values of several parameters joined by ":".

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    name, equals, told = (part.strip() for part in text.partition("="))
    fault = FAULTS.get(name.replace("-", "_"))
    if fault is None:
        near = difflib.get_close_matches(name, FAULTS, n=1)
        hint = f"did you mean {near[0]}?" if near else "'dslam degrade --list-faults' lists them"
        raise ConfigurationError(f"there is no fault {name!r}; {hint}")
    words = told.split(":") if equals else []
    if len(words) > len(fault.parameters):
        takes = f"write {fault.usage}" if fault.parameters else f"{fault.name} takes no value"
        raise ConfigurationError(
            f"fault {text!r}: {told!r} has {len(words)} values, not {len(fault.parameters)}; {takes}"
        )
    given = [_value(text, parameter, word) for parameter, word in zip(fault.parameters, words, strict=False)]
    return FaultCase(fault, (*given, *(p.default for p in fault.parameters[len(given) :])))


def parse_faults(texts: Sequence[str]) -> list[FaultCase]:
    """Each of the faults, in the order given.

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    return [parse_fault(text) for text in texts]


def all_cases(names: Sequence[str] = ()) -> list[FaultCase]:
    """What is measured: every case of every fault, or of those named; a name with a value is that case alone.

    Raises:
        ConfigurationError: a name that does not exist, or a value that is not allowed.
    """
    found: dict[str, FaultCase] = {}
    for text in names or FAULTS:
        first = parse_fault(text)
        values = first.fault.cases if "=" not in text else ()
        cases = [parse_fault(f"{first.fault.name}={value}") if value else first for value in values] or [first]
        found |= {case.name: case for case in cases}
    return list(found.values())


def _value(text: str, parameter: Parameter, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if (
        not parameter.least <= value <= parameter.most
        or not math.isfinite(value)
        or (parameter.is_whole and value != int(value))
    ):
        kind = "a whole number" if parameter.is_whole else "a number"
        most = f" and <= {parameter.most:g}" if math.isfinite(parameter.most) else ""
        raise ConfigurationError(
            f"fault {text!r}: {word!r} is not allowed as {parameter.name}; it is {kind} >= {parameter.least:g}{most}"
        )
    return value
