"""Errors of the estimator. One root; logs have their own, because they know nothing of SLAM."""


class SlamError(Exception):
    """Root of the estimator's errors; the message holds the values and the remedy."""


class ConfigurationError(SlamError):
    """A configuration key that does not exist or a value outside its range."""


class GeometryError(SlamError):
    """A matrix that is not a transform, or degenerate geometry."""


class FactorGraphError(SlamError):
    """The graph refuses a factor or cannot be solved; names the keyframe or landmark."""


class InputDataError(SlamError):
    """The log is readable, but what is in it cannot be mapped."""


class SavedMapError(SlamError):
    """A file that cannot be used as a map; says why, and how to make one."""


class EvaluationError(SlamError):
    """Nothing can be computed from what is there; the message says what is missing."""


class SimulationError(SlamError):
    """A world or drive that cannot be simulated."""


class FleetError(SlamError):
    """A fleet that cannot be mapped: no logs, or no worker."""
