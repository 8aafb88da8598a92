"""The estimators by name: section of the configuration, `--estimator` of the command line, stem of the executable."""

from __future__ import annotations

from jointest_ros.core.accel.analytical import AccelAnalytical
from jointest_ros.core.accel.ekf import AccelEkf
from jointest_ros.core.accel.ukf import AccelUkf
from jointest_ros.core.estimator import Estimator
from jointest_ros.core.kckf.gyro import Gyro
from jointest_ros.core.kckf.hall import Hall
from jointest_ros.core.kckf.kckf import Kckf
from jointest_ros.core.kckf.kf import Kf
from jointest_ros.core.pcf.pcf import Pcf

_ALL: tuple[type[Estimator], ...] = (Pcf, Gyro, Hall, Kf, Kckf, AccelAnalytical, AccelEkf, AccelUkf)
ESTIMATORS: dict[str, type[Estimator]] = {estimator.name: estimator for estimator in _ALL}
