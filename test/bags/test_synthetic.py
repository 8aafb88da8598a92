"""Simulated recordings as messages: the numbers of the simulation, in the order in which hardware would send them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jointest_ros.bags import cdr, synthetic
from jointest_ros.bags.ground_truth import TRUTH_JOINTS
from jointest_ros.bags.intake import HALL_TOPIC, Intake
from jointest_ros.bags.synthetic import FIRST_STAMP
from jointest_ros.bags.typestore import typestore
from jointest_ros.core.timing import Timing
from jointest_ros.sim import exoshell, finger, two_link_arm
from jointest_ros.sim.hand import ACCEL_NOISE, GYRO_NOISE, HandRecording
from jointest_ros.sim.simulated import SimulatedRobot

IMUS = [f"imu/{link}" for link in finger.LINKS]
MAGS = [f"mag/{link}" for link in finger.LINKS]


@pytest.fixture(scope="module")
def hand() -> HandRecording:
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


def test_topics(hand: HandRecording, shell: SimulatedRobot) -> None:
    assert synthetic.topics(hand.robot) == {
        **dict.fromkeys(IMUS, cdr.IMU),
        **dict.fromkeys(MAGS, cdr.MAGNETIC_FIELD),
        TRUTH_JOINTS: cdr.JOINT_STATE,
    }
    assert synthetic.topics(shell.robot)[HALL_TOPIC] == cdr.FLOAT32_MULTIARRAY


def test_every_topic_at_every_stamp_in_order(hand: HandRecording, shell: SimulatedRobot) -> None:
    for simulated in (hand, shell):
        messages = [(stamp, topic) for stamp, topic, _ in synthetic.messages([simulated])]
        stamps = (simulated.recording.stamps + FIRST_STAMP).tolist()
        assert messages == [(stamp, topic) for stamp in stamps for topic in synthetic.topics(simulated.robot)]
    assert stamps[0] >= FIRST_STAMP > 0


def test_the_numbers_are_those_of_the_simulation(hand: HandRecording) -> None:
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


def test_variances_are_those_of_one_sample(hand: HandRecording) -> None:
    _, _, data = next(synthetic.messages([hand]))
    message: Any = typestore().deserialize_cdr(data, cdr.IMU)
    assert message.angular_velocity_covariance[0] == pytest.approx(GYRO_NOISE**2 * 100.0)
    assert message.linear_acceleration_covariance[8] == pytest.approx(ACCEL_NOISE**2 * 100.0)


def test_sensors_without_gyro_say_so_and_are_taken() -> None:
    """NaN, and a covariance that begins with -1 (Imu.msg); what is not in use is not checked."""
    arm = two_link_arm.simulate(duration_s=0.3)
    message: Any = typestore().deserialize_cdr(next(synthetic.messages([arm]))[2], cdr.IMU)
    assert math.isnan(message.angular_velocity.z)
    assert message.angular_velocity_covariance.tolist() == [-1.0] + 8 * [0.0]
    intake = Intake(arm.robot, Timing())
    frames = []
    for stamp, topic, data in synthetic.messages([arm]):
        if topic in intake.handlers:
            frames += intake.handlers[topic](data, stamp)
    frames += intake.flush()
    assert all(intake.counts(topic) == {"messages": 30, "used": 30, "refused": {}} for topic in intake.topics)
    assert [list(frame.accel) for frame in frames] == [["a1", "a2", "b1", "b2"]] * 30
    assert frames[-1].accel["b2"] == tuple(arm.recording.accel["b2"][-1])
    assert not any(frame.gyro for frame in frames)


def test_stretches_give_the_same_messages_as_the_whole() -> None:
    options = finger.FingerOptions(rate_hz=100.0, duration_s=0.5, seed=5)
    whole = list(synthetic.messages([next(finger.stretches(options))]))
    parts = list(synthetic.messages(finger.stretches(options, chunk_s=0.2)))
    assert [message[:2] for message in parts] == [message[:2] for message in whole]
    truth = [[data for _, topic, data in messages if topic == TRUTH_JOINTS] for messages in (whole, parts)]
    assert truth[0] == truth[1]
