"""The ROS classes of the message types that this package sends and receives, by the names that bags use."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, MagneticField
from std_msgs.msg import Bool, Float32MultiArray, Float64MultiArray, MultiArrayDimension

from jointest_ros.bags import cdr

CLASSES: dict[str, Any] = {
    cdr.BOOL: Bool,
    cdr.CLOCK: Clock,
    cdr.FLOAT32_MULTIARRAY: Float32MultiArray,
    cdr.IMU: Imu,
    cdr.JOINT_STATE: JointState,
    cdr.MAGNETIC_FIELD: MagneticField,
    cdr.QUATERNION_STAMPED: QuaternionStamped,
    cdr.VECTOR3_STAMPED: Vector3Stamped,
}


SENSORS = (cdr.IMU, cdr.MAGNETIC_FIELD, cdr.FLOAT32_MULTIARRAY)  # the types of inputs, sent best effort


def labelled_array(labels: list[str], data: list[float]) -> Float64MultiArray:
    """Numbers with a label each; n labels and n * n numbers make a square matrix, row by row."""
    message = Float64MultiArray(data=data)
    width = len(data) // len(labels) if labels else 1
    for label in labels:
        message.layout.dim.append(MultiArrayDimension(label=label, size=width, stride=width))
    return message
