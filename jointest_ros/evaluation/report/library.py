"""The plot library that a report carries in itself: plotly.js, as the package plotly brings it (the extra `report`)."""

from __future__ import annotations

from jointest_ros.core.errors import JointestError


class ReportError(JointestError):
    """A report cannot be made; the text says why."""


def plotly_js() -> str:
    """The source of plotly.js. Raises ReportError with what to install, where it is not there."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise ReportError("--report needs plotly, which is not installed: pip install 'jointest_ros[report]'") from None
    try:
        return str(get_plotlyjs())
    except OSError:
        raise ReportError("--report: the installed plotly lacks its plotly.js: pip install --upgrade plotly") from None
