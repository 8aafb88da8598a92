"""What `kf` and `kckf` share: their common parameters, and the filters made from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointest_ros.core.kckf.chain_motion import ChainMotion, MotionFilter
from jointest_ros.core.kckf.coordinate import GapRule
from jointest_ros.core.kckf.coupled_bank import CoupledBank
from jointest_ros.core.kckf.coupled_filter import CoupledFilter
from jointest_ros.core.kckf.hall_bank import HallBank
from jointest_ros.core.kckf.hinge_filter import HingeFilter
from jointest_ros.core.kckf.joint_bank import HingeBank
from jointest_ros.core.kckf.linkage import Linkage
from jointest_ros.core.kckf.linkage_estimator import GAP_RATE_TEXT, KINEMATICS, KINEMATICS_TEXT
from jointest_ros.core.kckf.linkage_rates import ComposedRates
from jointest_ros.core.kckf.process_noise import ProcessNoise
from jointest_ros.core.params import Params, param
from jointest_ros.core.robot import Robot


@dataclass(frozen=True)
class FusionParams(Params):
    """Parameters of `kf` and `kckf`."""

    noise: str = param(
        "physical",
        "process noise: physical, from gyro_noise and gyro_bias_walk of the sensors; paper, its equation (13)",
        choices=("physical", "paper"),
    )
    hall_noise: str = param(
        "voltage",
        "voltage: each sensor's noise in volts, clipped ones left out; constant (the paper's): hall_sigma_deg for all",
        choices=("voltage", "constant"),
    )
    hall_sigma_deg: float = param(
        3.2, "standard deviation of a Hall angle with hall_noise: constant", unit="deg", low=1e-3, high=90.0
    )
    kinematics: str = param("composed", KINEMATICS_TEXT, choices=KINEMATICS)
    initial_angle_deg: float = param(
        10.0, "standard deviation of a joint angle at the start (about 0)", unit="deg", low=1e-3, high=180.0
    )
    initial_bias_dps: float = param(
        1.0, "standard deviation of the difference of two gyro biases at the start", unit="deg/s", low=0.0, high=100.0
    )
    gap_rate_dps: float = param(200.0, GAP_RATE_TEXT, unit="deg/s", low=0.0, high=1e4)

    @property
    def composed(self) -> bool:
        """Rotations instead of sums."""
        return self.kinematics == "composed"

    @property
    def hall_sigma(self) -> float:
        """Constant standard deviation of a Hall angle, rad; 0: measure in volts."""
        return math.radians(self.hall_sigma_deg) if self.hall_noise == "constant" else 0.0

    def process_noise(self, linkage: Linkage) -> ProcessNoise:
        """As chosen."""
        return ProcessNoise.of_paper(linkage) if self.noise == "paper" else ProcessNoise.physical(linkage)


def hinge_bank(
    linkage: Linkage, robot: Robot, params: FusionParams, noise: ProcessNoise, rule: GapRule, by_links: bool
) -> HingeBank:
    """Every coordinate in a filter of its own; `by_links`: rates need the kinematics of joints with several axes."""
    angle, bias = math.radians(params.initial_angle_deg) ** 2, math.radians(params.initial_bias_dps) ** 2
    filters = [
        HingeFilter(
            [(index, robot.hall[index]) for index in own],
            (noise.paper, float(noise.white[k, k]), float(noise.walk[k, k])),
            (angle * float(noise.angle_prior[k, k]), bias * float(noise.bias_prior[k, k])),
            rule,
            params.hall_sigma,
        )
        for k, own in enumerate(linkage.hall)
    ]
    return HingeBank(linkage, filters, len(robot.hall), ComposedRates(linkage) if by_links else None)


def coupled_bank(
    linkage: Linkage,
    robot: Robot,
    params: FusionParams,
    noise: ProcessNoise,
    rule: GapRule,
    by_links: bool,
    offset: tuple[float, float | None],
    motion: tuple[ChainMotion, float] | None,
) -> CoupledBank:
    """All coordinates in one filter.

    `offset`: standard deviation at the start (V) and walk (V/sqrt(s); None: no offset states) of the Hall sensors;
    `motion`: equations of the chain and alignment (rad) where gyro biases are the states.
    """
    start = (math.radians(params.initial_angle_deg), math.radians(params.initial_bias_dps), offset[0])
    hall = HallBank([robot.hall[index] for own in linkage.hall for index in own])
    coordinate = np.array([k for k, own in enumerate(linkage.hall) for _ in own], dtype=np.int64)
    filter_: CoupledFilter
    if motion is None:
        filter_ = CoupledFilter(hall, coordinate, noise, start, params.hall_sigma, offset[1])
    else:
        filter_ = MotionFilter(
            hall,
            coordinate,
            noise,
            start,
            params.hall_sigma,
            offset[1],
            motion=motion[0],
            gyro_noise=np.repeat([gyro.gyro_noise**2 for gyro in linkage.gyros], 3),
            gyro_walk=np.repeat([gyro.gyro_bias_walk**2 for gyro in linkage.gyros], 3),
            alignment=motion[1],
        )
    rates_of = ComposedRates(linkage) if by_links and motion is None else None
    return CoupledBank(linkage, filter_, len(robot.hall), rule, rates_of, not params.hall_sigma)
