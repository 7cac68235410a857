# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="abrace_core",
    version="1.0.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_core"]),
        ("share/abrace_core", ["package.xml"]),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="The base of abrace, without ROS: linear models with named signals, exact simulation, safety checks, files and figures.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
