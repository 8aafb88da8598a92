"""The registry of rigs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from jointest_ros.core.errors import JointestError
from jointest_ros.sim.scenarios import SCENARIOS, Rig


@pytest.mark.parametrize("rig", SCENARIOS.values(), ids=SCENARIOS)
def test_every_rig_makes_every_scenario(rig: Rig) -> None:
    for scenario in rig.scenarios:
        made = rig.make(scenario, rate_hz=100.0, duration_s=3.0, seed=1)
        shape = (len(made.recording), len(made.joint_names))
        assert made.truth_position.shape == made.truth_velocity.shape == shape
        assert set(made.joint_names) <= set(made.robot.coordinates)
        samples = [*made.recording.gyro.items(), *made.recording.accel.items()]
        for name, values in samples:
            assert made.robot.sensor(name)
            assert values.shape == (shape[0], 3)
            assert np.isfinite(values).all()


@pytest.mark.parametrize("rig", SCENARIOS.values(), ids=SCENARIOS)
def test_a_rig_names_its_scenarios_when_asked_for_another(rig: Rig) -> None:
    with pytest.raises(JointestError) as caught:
        rig.make("nonsense")
    assert all(name in str(caught.value) for name in rig.scenarios)


@pytest.mark.parametrize("name", SCENARIOS)
def test_rigs_and_options_describe_themselves(name: str) -> None:
    rig = SCENARIOS[name]
    assert rig.name == name and rig.description and all(rig.scenarios.values())
    options = {field.name: field for field in dataclasses.fields(rig.options)}
    assert {"scenario", "rate_hz", "duration_s", "seed"} <= set(options)
    assert all(field.metadata["description"] for field in options.values())
