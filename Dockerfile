# SPDX-License-Identifier: Apache-2.0
# What `make demo` needs, on a machine without ROS 2: docker build -t abrace . && docker run --rm -v "$PWD/out:/out" abrace
FROM python:3.12-slim-bookworm
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ git make \
    && rm -rf /var/lib/apt/lists/*
COPY . /abrace
WORKDIR /abrace
RUN make setup
WORKDIR /out
# its results and bags are in the folder that is mounted
CMD ["bash", "-c", "source /abrace/ros2_ws/setup.bash && abrace demo"]
