"""What a user sets of `pcf`."""

from __future__ import annotations

from dataclasses import dataclass

from jointest_ros.core.params import Params, param

FORMULATIONS = ("hinge", "relative", "absolute")


@dataclass(frozen=True)
class PcfParams(Params):
    """The `estimators: pcf:` section of a configuration."""

    formulation: str = param("hinge", "which filter: see the estimator's page", choices=FORMULATIONS)
    kp: float = param(
        1.0,
        "proportional gain of relative and absolute; lower it where the robot shakes",
        unit="1/s",
        low=0.0,
        high=100.0,
    )
    ki: float = param(
        0.05, "integral gain of relative and absolute (learns the gyro bias)", unit="1/s^2", low=0.0, high=100.0
    )
    accel_weight: float = param(1.0, "weight of the accelerometers in the correction", low=0.0, high=1e3)
    mag_weight: float = param(0.0, "weight of the magnetometers in the correction; 0: not used", low=0.0, high=1e3)
    axes_weight: float = param(
        0.3,
        "weight, in the correction about gravity, of the two axes about which alone a joint of two axes turns",
        low=0.0,
        high=1e3,
    )
    mag_norm_ut: float = param(
        0.0,
        "norm of the undisturbed field, to which mag_dip_deg belongs; 0: both are learnt at rest",
        unit="uT",
        low=0.0,
        high=1e3,
    )
    mag_dip_deg: float = param(0.0, "dip of the undisturbed field below horizontal", unit="deg", low=-90.0, high=90.0)
    mag_norm_tolerance: float = param(
        0.1, "a field whose norm differs by more than this share is disturbed: not used", low=1e-3, high=1e3
    )
    mag_dip_tolerance_deg: float = param(
        10.0, "a field whose dip differs by more than this is disturbed: not used", unit="deg", low=0.1, high=180.0
    )
    accel_time: float = param(
        0.0,
        "once the gyros are calibrated, accelerometers are averaged over this time, in the frame that the gyros carry "
        "along, before they correct: accelerations of links that go back and forth cancel; 0: never, as in the paper",
        unit="s",
        low=0.0,
        high=60.0,
    )
    lever_arms: bool = param(
        False,
        "accelerations by the turning of the links are computed and removed; needs the positions of the sensors "
        "and the origins of the joints; not for absolute",
    )
    bias_walk_dps: float = param(
        1e-4, "hinge: random walk of the gyro bias difference", unit="deg/s/sqrt(s)", low=0.0, high=10.0
    )
    bias_std_dps: float = param(
        4.0, "hinge: standard deviation of an uncalibrated gyro bias difference", unit="deg/s", low=0.0, high=100.0
    )
    calibrated_bias_std_dps: float = param(
        0.005, "hinge: the same after a calibration at rest", unit="deg/s", low=0.0, high=100.0
    )
    gap_rate_dps: float = param(
        200.0,
        "standard deviation of the joint rate that a gap longer than max_gap hides",
        unit="deg/s",
        low=0.0,
        high=1e4,
    )
    floor_deg: float = param(
        0.05,
        "added to the reported standard deviation for lever arms and mounting, which no sensor noise covers",
        unit="deg",
        low=0.0,
        high=45.0,
    )
    gravity_cone_deg: float = param(
        10.0, "hinge: an axis closer to gravity than this runs on the gyro alone", unit="deg", low=0.1, high=45.0
    )
    still_start: float = param(
        1.0,
        "gyro biases are calibrated when the robot stands still for this long at the start; 0: never",
        unit="s",
        low=0.0,
        high=60.0,
    )
    still_gyro_dps: float = param(
        1.0, "still: largest standard deviation of a gyro axis", unit="deg/s", low=1e-3, high=100.0
    )
    still_accel: float = param(
        0.5, "still: largest standard deviation of an accelerometer axis", unit="m/s^2", low=1e-3, high=10.0
    )
    largest_bias_dps: float = param(
        5.0, "still: a mean rate above this is motion, not bias", unit="deg/s", low=1e-3, high=100.0
    )
    zero_at_start: bool = param(False, "the pose of the still start is the zero pose of every joint")
