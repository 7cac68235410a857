# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="abrace_core",
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_core"]),
        ("share/abrace_core", ["package.xml"]),
        ("share/abrace_core/config", ["config/shared_memory.xml", "config/streams.xml"]),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="What the nodes of abrace share: linear models with named signals, exact simulation, MCAP bags, safety checks and node conventions.",
    license="Apache-2.0",
)
