"""The estimators by name: section of the configuration, `--estimator` of the command line, stem of the executable.

Another package adds its own by an entry point of the group `jointest_ros.estimators`, whose name is that of the class.
"""

from __future__ import annotations

import warnings
from importlib.metadata import entry_points

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
"""Name -> class; those of other packages included."""


def _add_those_of_other_packages() -> None:
    """One that cannot be loaded, or takes a name that there is, is left out with a warning."""
    for entry in entry_points(group="jointest_ros.estimators"):
        try:
            kind = entry.load()
            sound = issubclass(kind, Estimator) and kind.name == entry.name and entry.name not in ESTIMATORS
            reason = f"it must be an Estimator, named '{entry.name}' as no other is"
        except Exception as error:  # whatever the code of others raises
            sound, reason = False, f"{type(error).__name__}: {error}"
        if sound:
            ESTIMATORS[entry.name] = kind
        else:
            warnings.warn(f"estimator {entry.name} = {entry.value} is left out: {reason}", stacklevel=2)


_add_those_of_other_packages()
