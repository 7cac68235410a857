# SPDX-License-Identifier: Apache-2.0
from setuptools import setup

setup(
    name="skyhook",
    version="1.0.0",
    packages=["skyhook"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/skyhook"]),
        ("share/skyhook", ["package.xml"]),
        ("share/skyhook/launch", ["launch/el_centro.launch.py"]),
    ],
    entry_points={"console_scripts": ["skyhook = skyhook.skyhook:main"]},
)
