# SPDX-License-Identifier: Apache-2.0
from setuptools import setup

setup(
    name="sliding_mode",
    version="1.0.0",
    packages=["sliding_mode"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/sliding_mode"]),
        ("share/sliding_mode", ["package.xml"]),
        ("share/sliding_mode/launch", ["launch/el_centro.launch.py"]),
    ],
    entry_points={"console_scripts": ["sliding_mode = sliding_mode.sliding_mode:main"]},
)
