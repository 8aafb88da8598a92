"""From `plan` to `ros2 launch`: all that knows the packages launch and launch_ros."""

from __future__ import annotations

import dataclasses

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from jointest_ros.core.params import allowed_text
from jointest_ros.view.plan import LaunchArguments, Process, defaults, joined, processes


def launch_description(robot: str) -> LaunchDescription:
    """What the launch file of one robot gives: its arguments, and what they ask for."""
    default_of = defaults(robot)
    arguments = [
        DeclareLaunchArgument(
            spec.name,
            default_value=default_of[spec.name],
            description=f"{spec.metadata['description']} ({allowed_text(spec)})",
        )
        for spec in dataclasses.fields(LaunchArguments)
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_start)])


def _start(context: LaunchContext) -> list[Node]:
    given = context.launch_configurations
    values = {spec.name: given[spec.name] for spec in dataclasses.fields(LaunchArguments)}
    # PushRosNamespace around an inclusion of the launch file
    values["namespace"] = joined(given.get("ros_namespace", ""), values["namespace"])
    return [_node(process) for process in processes(LaunchArguments.from_text(values))]


def _node(process: Process) -> Node:
    return Node(
        package=process.package,
        executable=process.executable,
        name=process.name,
        namespace=process.namespace,
        parameters=[dict(process.parameters)] if process.parameters else None,
        remappings=list(process.remappings.items()),
        arguments=list(process.arguments),
        output="screen",
    )
