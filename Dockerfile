# syntax=docker/dockerfile:1
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
# ROS 2 Jazzy with this package, built by colcon; docs/tutorial.md has the commands.
FROM ros:jazzy-ros-base AS dependencies
WORKDIR /opt/sphere
COPY package.xml src/sphere_nmpc/
# What apt does not have is installed by pip below; Ubuntu refuses pip outside of a virtual
# environment. The base image has the compiler.
# hadolint ignore=DL3008
RUN echo 'APT::Install-Recommends "false";' > /etc/apt/apt.conf.d/00recommends \
    && apt-get update \
    && rosdep install --from-paths src --ignore-src -y --dependency-types exec \
        --skip-keys "mcap-ros2-support python3-mujoco-pip python3-rosbags-pip" \
    && apt-get install -y --no-install-recommends python3-venv \
    && rm -rf /var/lib/apt/lists/*

FROM dependencies AS build
# ROS messages of apt are compiled for Ubuntu's NumPy, which pip must not replace.
RUN echo "numpy<2" > constraints.txt
ENV PIP_CONSTRAINT=/opt/sphere/constraints.txt
RUN python3 -m venv --system-site-packages venv
COPY . src/sphere_nmpc
# colcon writes the interpreter that runs it into the scripts.
RUN --mount=type=cache,target=/root/.cache/pip . /opt/ros/jazzy/setup.sh \
    && venv/bin/python -m colcon build --base-paths src --packages-select sphere_nmpc \
    && . install/setup.sh \
    && venv/bin/pip install "sphere_nmpc[record,sim,rigid,viewer,study,report]"

FROM dependencies
COPY --from=build /opt/sphere/venv venv
COPY --from=build /opt/sphere/install install
# The user `ubuntu` of the base image.
USER 1000
WORKDIR /home/ubuntu
# ros2 launch ends its nodes in order on SIGINT. There is no health check: a launch ends with its
# nodes, and the other commands of the package have none to ask.
STOPSIGNAL SIGINT
ENTRYPOINT ["/bin/bash", "-c", "source /opt/sphere/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "launch", "sphere_nmpc", "sphere.launch.py"]
