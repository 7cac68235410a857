# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="abrace_node",
    version="1.0.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_node"]),
        ("share/abrace_node", ["package.xml"]),
        ("share/abrace_node/config", ["config/shared_memory.xml", "config/streams.xml"]),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="What the ROS 2 nodes of abrace share: parameters, life cycle, process and transport.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
