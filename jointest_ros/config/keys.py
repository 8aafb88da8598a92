"""What the keys of a configuration mean that are no `Params`: said once, for the files that `jointest init` writes."""

from __future__ import annotations

TREE = (
    "All link frames coincide in orientation at the zero pose, so an axis has the same components in both of its "
    "links. A joint position is the child relative to the parent, positive about +axis."
)
KEYS = {
    "world": "a link that stands still with z up and bears no sensor: angles of joints from it are relative to gravity",
    "axis": "x, y, z, -x, -y, -z or three numbers; axes: a list of two or three of them",
    "origin": "of the joint in the parent's frame, m; the child's frame begins there",
    "names": "of the joint positions, one an axis; <joint>_<axis> unless given",
    "limits_deg": "lowest and highest position, deg; of several axes a list of such pairs",
    "continuous": "true: positions are equal modulo a turn",
    "link": "that the sensor is fixed to; the one of the sensor's name unless given",
    "position": "of the sensor in its link's frame, m",
    "mounting": "rotation from the sensor's frame to the link's: rpy_deg (as in URDF) or quaternion (x, y, z, w)",
    "topic": "of its sensor_msgs/Imu; imu/<name> unless given",
    "frame_id": "where several sensors share a topic: only messages with this one are this sensor's",
    "calibration_file": "written by `jointest calibrate`, beside this file; what stands there takes precedence",
    "hall": "in the order of the voltages in hall_voltages (row by row); mirrored: on the other side",
}
