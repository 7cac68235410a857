# SPDX-License-Identifier: Apache-2.0
from setuptools import setup

setup(
    name="own_nodes",
    version="0.0.0",
    packages=["own_nodes"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/own_nodes"]),
        ("share/own_nodes", ["package.xml"]),
    ],
    entry_points={"console_scripts": ["floors = own_nodes.floors:main"]},
)
