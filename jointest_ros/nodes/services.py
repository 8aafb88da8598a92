"""The services of an estimator node: start afresh, calibrate at rest, keep what was learned for the next start.

Each refuses with the reason while the robot moves or no data arrives.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from jointest_ros.bags.intake import Intake
from jointest_ros.config import Configuration, calibration
from jointest_ros.core.errors import CalibrationError, ConfigurationError
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.learned import Learned

NO_DATA = 1.0  # s without estimates after which there is nothing to calibrate from


class Services:
    """Offers those that fit the estimator.

    Args:
        intake: which tells what moves.
        estimator: that estimates at present: it is replaced when it is tuned.
        estimated: when it made its newest estimate, monotonic ns; 0: never.
    """

    def __init__(
        self,
        node: Node,
        intake: Intake,
        estimator: Callable[[], Estimator],
        estimated: Callable[[], int],
        configuration: Configuration,
    ) -> None:
        self._node, self._intake, self._estimator, self._estimated = node, intake, estimator, estimated
        self._configuration = configuration
        self._serve("reset", self._reset)
        for name in ("calibrate_zero", "calibrate_gyro_bias"):
            if hasattr(estimator(), name):
                self._serve(name, partial(self._calibrate, name))
        if type(estimator()).learned is not Estimator.learned:
            self._serve("save_calibration", self._save)

    def _serve(self, name: str, action: Callable[[], str]) -> None:
        def answer(_request: Any, response: Any) -> Any:
            try:
                response.message = action()
                response.success = True
            except CalibrationError as error:
                response.success, response.message = False, str(error)
            return response

        self._node.create_service(Trigger, f"~/{name}", answer)

    def _require_data(self) -> None:
        if time.monotonic_ns() - self._estimated() > NO_DATA * 1e9:
            raise CalibrationError("no data arrives: see /diagnostics for which topics are silent")

    def _require_rest(self) -> None:
        self._require_data()
        moving = [sensor for sensor, at_rest in self._intake.assembler.quality.at_rest.items() if not at_rest]
        if moving:
            raise CalibrationError(f"the robot moves ({', '.join(moving)}): hold it still for 2 s and try again")

    def _reset(self) -> str:
        self._require_rest()
        self._estimator().reset()
        return "started afresh"

    def _calibrate(self, name: str) -> str:
        self._require_data()
        getattr(self._estimator(), name)()  # which judges for itself, by longer means, whether the robot is at rest
        return "done"

    def _save(self) -> str:
        self._require_rest()
        learned = self._estimator().learned()
        if learned is None:
            if hasattr(self._estimator(), "calibrate_gyro_bias"):
                raise CalibrationError("gyro biases were never measured at rest: call ~/calibrate_gyro_bias first")
            raise CalibrationError("this estimator, as it is set, learns nothing of its sensors that could be saved")
        target = self._target()
        self._write(target, learned)
        saved = f"biases {', '.join(learned.biases)}"
        saved += f"; zero poses of {', '.join(learned.zero)}" if learned.zero else ""
        if getattr(self._estimator().params, "zero_at_start", False):
            saved += "; zero poses not: zero_at_start takes them at every start"
        return f"{target}: {saved}{self._advice(target)}"

    def _target(self) -> Path:
        """The calibration file of the configuration, or a new one beside it."""
        configuration = self._configuration
        assert configuration.path is not None
        beside = configuration.path.with_name(f"{configuration.path.stem}_calibration.yaml")
        return configuration.calibration_file or beside

    def _write(self, target: Path, learned: Learned) -> None:
        name, now = self._estimator().name, datetime.now(timezone.utc)
        saved = f"{now:%Y-%m-%d %H:%M:%S} UTC"
        heading = (
            f"Learned by {self._node.get_fully_qualified_name()}, saved by ~/save_calibration, {saved}.\n"
            "Biases with their standard deviation in rad/s (gyros), V (Hall), m/s^2 (accelerometers); zero poses."
        )
        try:
            calibration.load(target, self._configuration.robot)
            calibration.save_learned(target, name, replace(learned, saved=saved), heading)
        except ConfigurationError as error:
            raise CalibrationError(f"{error}; it stays as it is: mend it or remove it") from None

    def _advice(self, target: Path) -> str:
        configuration = self._configuration
        if configuration.calibration_file is not None or configuration.path is None:
            return ""
        name = os.path.relpath(target.resolve(), configuration.path.resolve().parent)
        return f"; for the next start to use it, write into {configuration.path}: calibration_file: {name}"
