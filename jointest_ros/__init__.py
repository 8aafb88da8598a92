"""Joint angles without encoders: estimators for link-mounted IMUs, Hall sensors and accelerometer arrays."""

__version__ = "0.1.0"
