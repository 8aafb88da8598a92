"""Simulated recordings as messages: the numbers of the simulation, in the order in which hardware would send them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jointest_ros.bags import cdr, synthetic
from jointest_ros.bags.intake import HALL_TOPIC
from jointest_ros.bags.offline import TRUTH_JOINTS
from jointest_ros.bags.synthetic import FIRST_STAMP
from jointest_ros.bags.typestore import typestore
from jointest_ros.sim import exoshell, finger
from jointest_ros.sim.simulated import SimulatedRobot

IMUS = [f"imu/{link}" for link in finger.LINKS]
MAGS = [f"mag/{link}" for link in finger.LINKS]


@pytest.fixture(scope="module")
def hand() -> finger.FingerRecording:
    return finger.simulate("PC", rate_hz=100.0, duration_s=0.3, zero_pose_s=0.0, mag=True, seed=3)


@pytest.fixture(scope="module")
def shell() -> SimulatedRobot:
    return exoshell.simulate(rate_hz=100.0, duration_s=0.3)


def decoded(simulated: SimulatedRobot, topic: str) -> list[Any]:
    """The messages of one topic, decoded."""
    decode: Any = {
        cdr.IMU: cdr.decode_imu,
        cdr.MAGNETIC_FIELD: cdr.decode_magnetic_field,
        cdr.FLOAT32_MULTIARRAY: cdr.decode_float32_multiarray,
        cdr.JOINT_STATE: cdr.decode_joint_state,
    }[synthetic.topics(simulated.robot)[topic]]
    return [decode(data) for _, name, data in synthetic.messages([simulated]) if name == topic]


def test_topics(hand: finger.FingerRecording, shell: SimulatedRobot) -> None:
    assert synthetic.topics(hand.robot) == {
        **dict.fromkeys(IMUS, cdr.IMU),
        **dict.fromkeys(MAGS, cdr.MAGNETIC_FIELD),
        TRUTH_JOINTS: cdr.JOINT_STATE,
    }
    assert synthetic.topics(shell.robot)[HALL_TOPIC] == cdr.FLOAT32_MULTIARRAY


def test_every_topic_at_every_stamp_in_order(hand: finger.FingerRecording, shell: SimulatedRobot) -> None:
    for simulated in (hand, shell):
        messages = [(stamp, topic) for stamp, topic, _ in synthetic.messages([simulated])]
        stamps = (simulated.recording.stamps + FIRST_STAMP).tolist()
        assert messages == [(stamp, topic) for stamp in stamps for topic in synthetic.topics(simulated.robot)]
    assert stamps[0] >= FIRST_STAMP > 0


def test_the_numbers_are_those_of_the_simulation(hand: finger.FingerRecording) -> None:
    for link in finger.LINKS:
        stamps, frame_ids, gyro, accel = zip(*decoded(hand, f"imu/{link}"), strict=True)
        assert stamps == tuple(hand.recording.stamps + FIRST_STAMP)
        assert set(frame_ids) == {link}
        assert np.array_equal(gyro, hand.recording.gyro[link])
        assert np.array_equal(accel, hand.recording.accel[link])
        assert np.array_equal([field for *_, field in decoded(hand, f"mag/{link}")], hand.recording.mag[link])
    _, names, positions, velocities = zip(*decoded(hand, TRUTH_JOINTS), strict=True)
    assert set(names) == {finger.JOINTS}
    assert np.array_equal(positions, hand.truth_position)
    assert np.array_equal(velocities, hand.truth_velocity)


def test_hall_voltages_and_sensors_without_accelerometer(shell: SimulatedRobot) -> None:
    voltages, dims = zip(*decoded(shell, HALL_TOPIC), strict=True)
    assert shell.recording.hall is not None
    assert np.array_equal(np.array(voltages, dtype=np.float32), shell.recording.hall.astype(np.float32))
    assert set(dims) == {(("joint", 4), ("sensor", 2))}
    sensor = shell.robot.sensors[0]
    assert not sensor.accel
    assert all(math.isnan(a[0]) for *_, a in decoded(shell, sensor.topic))


def test_variances_are_those_of_one_sample(hand: finger.FingerRecording) -> None:
    _, _, data = next(synthetic.messages([hand]))
    message: Any = typestore().deserialize_cdr(data, cdr.IMU)
    assert message.angular_velocity_covariance[0] == pytest.approx(finger.GYRO_NOISE**2 * 100.0)
    assert message.linear_acceleration_covariance[8] == pytest.approx(finger.ACCEL_NOISE**2 * 100.0)


def test_stretches_give_the_same_messages_as_the_whole() -> None:
    options = finger.FingerOptions(rate_hz=100.0, duration_s=0.5, seed=5)
    whole = list(synthetic.messages([next(finger.stretches(options))]))
    parts = list(synthetic.messages(finger.stretches(options, chunk_s=0.2)))
    assert [message[:2] for message in parts] == [message[:2] for message in whole]
    truth = [[data for _, topic, data in messages if topic == TRUTH_JOINTS] for messages in (whole, parts)]
    assert truth[0] == truth[1]
