# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""All package metadata; colcon cannot read it from a ``[project]`` table in pyproject.toml."""

from glob import glob

from setuptools import find_packages, setup

NAME = "sphere_nmpc"
SHARED = ("config", "launch", "rviz", "foxglove", "urdf", "msg_docs", "hook")
VERBS = (
    "demo", "simulator", "controller", "recorder", "goal", "viewer", "markers", "study",
    "benchmark", "report",
)
EXTRAS = {
    "ros": ["ros-jazzy-rclpy[fastrtps]>=7.1,<8", "ros-jazzy-common-interfaces>=5.3,<6"],
    # Of rosbags the type store and the form in which bags hold QoS profiles are used. Its minor
    # versions below 1.0 change interfaces, as 0.11 did those of the reader, which tests use.
    "record": [
        "rosbags>=0.11,<0.12",
        "mcap>=1.2,<2",
        "mcap-ros2-support>=0.5,<1",
        "ruamel.yaml>=0.18",
        "zstandard>=0.22",
    ],
    "sim": ["rich>=13", "matplotlib>=3.8,<4"],
    "study": ["dask>=2024.8", "distributed>=2024.8"],
    "rigid": ["mujoco>=3.2,<5"],
    "viewer": ["viser>=1.0,<2"],
    "report": [
        "rosbags>=0.11,<0.12",
        "mcap>=1.2,<2",
        "ruamel.yaml>=0.18",
        "zstandard>=0.22",
        "matplotlib>=3.8,<4",
        "pyarrow>=16",
    ],
    # launch_testing's pytest plugin breaks under pytest 9.
    "test": [
        "pytest>=7.4,<9",
        "pytest-xdist>=3.3",
        "hypothesis>=6.100",
        "ruff>=0.9",
        "mypy>=1.14",
        "packaging",
    ],
}

setup(
    name=NAME,
    version="0.1.0",
    description="NMPC of a rolling sphere with two rotors, to any position and orientation",
    long_description=(
        "A ROS 2 Jazzy package with simulator, nonlinear model predictive controller, recorder, "
        "viewer and study tools for a rolling sphere driven by two internal rotors."
    ),
    maintainer="sphere_nmpc maintainers",
    maintainer_email="sphere-nmpc@example.org",
    license="Apache-2.0",
    classifiers=[
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
    ],
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*", "sphere_sim", "sphere_sim.*"]),
    package_data={"": ["py.typed", "*.c", "*.h", "*.css", "*.html", "*.js", "*.csv", "*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        # Where the hook of a colcon workspace (colcon.pkg) finds it.
        (f"share/{NAME}/bin", [f"hook/{NAME}"]),
        *((f"share/{NAME}/{folder}", sorted(glob(f"{folder}/*.*"))) for folder in SHARED),
    ],
    install_requires=["numpy>=1.26,<3", "scipy>=1.11,<2", "casadi>=3.6.7,<4"],
    extras_require={**EXTRAS, "all": sorted({r for rs in EXTRAS.values() for r in rs})},
    entry_points={
        "console_scripts": [
            "sphere_nmpc = sphere_sim.cli.main:main",
            # Each verb too, for `ros2 run`; the command knows the verb by the name of the script.
            *(f"{verb} = sphere_sim.cli.main:main" for verb in VERBS),
        ]
    },
)
