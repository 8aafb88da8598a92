"""How the bound of a joint angle falls with the span of its accelerometer arrays, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jointest_ros.core.frame import FloatArray
from jointest_ros.evaluation.picture import PlotError, save
from jointest_ros.evaluation.plots import check_suffix

_WIDTH, _HEIGHT = 9.0, 4.0  # inches, of one joint


@dataclass(frozen=True)
class SpanCurves:
    """One joint.

    Attributes:
        joint: its name.
        spans: (S,) of both arrays over the lengths of their links.
        bounds_deg: by motion, (S,).
        now_deg: by motion, of the sensors as they are.
    """

    joint: str
    spans: FloatArray
    bounds_deg: dict[str, FloatArray]
    now_deg: dict[str, float]


def draw(path: Path, title: str, joints: Sequence[SpanCurves]) -> None:
    """Write the picture; the suffix of `path` says which format.

    Raises:
        PlotError: the suffix is unknown, there is no curve, or the file cannot be written.
    """
    check_suffix(path)
    joints = [joint for joint in joints if joint.bounds_deg]
    if not joints:
        raise PlotError(f"{path}: nothing to draw: no motion tells the angle of a joint")
    from matplotlib.figure import Figure  # takes longer to load than many a command to run

    figure = Figure(figsize=(_WIDTH, _HEIGHT * len(joints)), dpi=120, layout="constrained")
    figure.suptitle(title)
    for axes, joint in zip(figure.subplots(len(joints), squeeze=False)[:, 0], joints, strict=True):
        for number, (motion, values) in enumerate(joint.bounds_deg.items()):
            axes.plot(joint.spans, values, "o-", color=f"C{number}", markersize=3.0, label=motion)
            axes.axhline(joint.now_deg[motion], color=f"C{number}", linestyle=":", linewidth=1.0)
        axes.plot([], [], "0.4", linestyle=":", linewidth=1.0, label="sensors as they are")
        axes.set(title=joint.joint, ylabel="bound of the angle, deg")
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("span of both arrays over the length of their link (array in the middle)")
        axes.grid(color="0.9")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)
    save(figure, path)
