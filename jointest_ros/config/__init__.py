"""The configuration of a robot, its calibration file, and the way back to YAML."""

from jointest_ros.config.reader import Configuration, SensorSettings, load, parse

__all__ = ["Configuration", "SensorSettings", "load", "parse"]
