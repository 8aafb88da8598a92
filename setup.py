"""What is installed where, in one layout for `pip install`, `colcon build` and `colcon build --symlink-install`.

    bin/<name>                  each command, written by the installer for the Python that it installs into
    lib/jointest_ros/<name>     where `ros2 run` and launch files look: scripts/<name>, which starts bin/<name>
    share/jointest_ros/...      package.xml, configurations, launch files, robot models, views, recordings
    share/ament_index/...       the marker by which ROS finds the package

pip copies data files as they are and ignores `install_scripts`: nobody would write the right Python into the first line
of a Python script in lib/. A shell script that steps over to bin/ needs none.
"""

import os

from setuptools import Distribution, find_packages, setup

PACKAGE = "jointest_ros"

ESTIMATORS = ("pcf", "gyro", "hall", "kf", "kckf", "accel_analytical", "accel_ekf", "accel_ukf")

# command -> the module whose main() it runs
COMMANDS = {
    "jointest": "jointest_ros.cli.main",
    **{f"{name}_node": "jointest_ros.nodes.start" for name in (*ESTIMATORS, "sim_hardware")},
}

# folders that share/ gets, as far as they exist
DATA = ["config", "launch", "urdf", "rviz", "foxglove", "bags", "sros2"]


def shared_files() -> list[tuple[str, list[str]]]:
    """The destination and the files of every folder of data."""
    found = []
    for top in DATA:
        for folder, _, names in os.walk(top):
            # isfile: links to files that are gone stay behind in colcon's build folder
            files = [os.path.join(folder, name) for name in sorted(names)]
            files = [file for file in files if os.path.isfile(file) and not file.endswith(".pyc")]
            if files:
                found.append((os.path.join("share", PACKAGE, folder), files))
    return found


class DistributionWithData(Distribution):
    """`pip install -e` asks for has_data, which setuptools lacks, and leaves the data files out."""

    has_data = Distribution.has_data_files


setup(
    distclass=DistributionWithData,
    version="0.1.0",
    python_requires=">=3.10",  # in setup.cfg it becomes an object that colcon cannot read
    packages=find_packages(include=[PACKAGE, PACKAGE + ".*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + PACKAGE]),
        ("share/" + PACKAGE, ["package.xml"]),
        ("lib/" + PACKAGE, ["scripts/" + name for name in COMMANDS]),
        *shared_files(),
    ],
    entry_points={"console_scripts": [f"{name} = {module}:main" for name, module in COMMANDS.items()]},
)
