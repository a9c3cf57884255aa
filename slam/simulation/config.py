"""Configuration of a simulated drive: every number has its unit, range and meaning; unknown keys are refused."""

from pydantic import Field

from slam.common.config_tree import Branch


class DriveConfig(Branch):
    """Motion of the body along the tour."""

    speed_mps: float = Field(default=8.0, gt=0, le=50)
    """cruising speed [m/s]"""
    rate_hz: float = Field(default=10.0, gt=0, le=1000)
    """scans and odometry messages per second [1/s]"""
    corner_smoothing_m: float = Field(default=1.5, ge=0, le=20)
    """sigma of the Gaussian along the tour that rounds its corners [m]"""
    max_yaw_rate_radps: float = Field(default=0.8, gt=0, le=10)
    """maximum turning rate in bends [rad/s]"""
    max_lateral_acceleration_mps2: float = Field(default=2.0, gt=0, le=50)
    """maximum lateral acceleration in bends [m/s^2]"""
    max_acceleration_mps2: float = Field(default=2.0, gt=0, le=50)
    """maximum acceleration and deceleration [m/s^2]"""
    start_day: int = Field(default=0, ge=0, le=36500)
    """start of the drive, days after 2023-11-14 [d]"""


class OdometryConfig(Branch):
    """Drift of the odometry; see ``drifting_odometry`` in ``slam.simulation.simulation`` for the exact model."""

    scale_drift_percent: float = Field(default=1.0, ge=0, le=50)
    """rms error of the length accumulated over 100 m of path, in percent of it"""
    scale_correlation_m: float = Field(default=20.0, gt=0, le=1000)
    """path over which the scale error decays to 1/e [m]"""
    heading_drift_deg_per_100m: float = Field(default=0.5, ge=0, le=90)
    """rms error of the heading accumulated over 100 m of path [deg]"""


class SensorConfig(Branch):
    """Range and errors of the object detector."""

    max_range_m: float = Field(default=30.0, gt=0, le=1000)
    """range of the sensor [m]"""
    field_of_view_deg: float = Field(default=360.0, gt=0, le=360)
    """horizontal field of view, centred ahead [deg]"""
    occlusion: bool = True
    """nearer objects occlude farther ones"""
    occluder_radius_m: float = Field(default=0.25, ge=0, le=10)
    """radius of an object that occludes others [m]"""
    noise_base_m: float = Field(default=0.1, ge=0, le=10)
    """position noise per axis at range zero, 1 sigma [m]"""
    noise_per_m: float = Field(default=0.01, ge=0, le=1)
    """growth of the position noise with the range [m / m]"""
    dropout: float = Field(default=0.1, ge=0, le=1)
    """probability that a visible object is missed in a scan"""
    false_positives_per_scan: float = Field(default=0.5, ge=0, le=1000)
    """mean number of false objects per scan"""
    misclassification: float = Field(default=0.1, ge=0, le=1)
    """probability of a wrong label at max_range_m; linear in the range, 0 at 0"""
    covariances: bool = True
    """detections carry the covariance of the noise model"""


class KidnapConfig(Branch):
    """The robot is taken from one place of the tour to another, while nothing is logged or unnoticed."""

    from_m: float = Field(gt=0)
    """distance along the tour at which the robot is kidnapped [m]"""
    to_m: float = Field(ge=0)
    """distance along the tour at which the drive continues, to its end [m]"""
    gap_s: float = Field(default=5.0, gt=0, le=86400)
    """time without messages [s]"""
    before_m: float | None = Field(default=None, gt=0)
    """travel before the kidnapping; not set: from the start of the tour [m]"""
    after_m: float | None = Field(default=None, gt=0)
    """travel after it; not set: to the end of the tour [m]"""
    silent: bool = False
    """without a gap: the odometry continues as if the robot had driven straight on"""


class SimulationConfig(Branch):
    """The whole simulated drive."""

    drive: DriveConfig = DriveConfig()
    odometry: OdometryConfig = OdometryConfig()
    sensor: SensorConfig = SensorConfig()
    kidnap: KidnapConfig | None = None
    """kidnap the robot once"""
