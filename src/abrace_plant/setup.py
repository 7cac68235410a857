# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace_plant",
    version="1.0.0",
    packages=find_packages(),
    package_data={"abrace_plant.devices": ["c99/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_plant"]),
        ("share/abrace_plant", ["package.xml"]),
        ("share/abrace_plant/config", sorted(glob("config/*.yaml"))),
        ("share/abrace_plant/config/devices", sorted(glob("config/devices/*.yaml"))),
        ("share/abrace_plant/config/device_parts", sorted(glob("config/device_parts/*.yaml"))),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="The laboratory: building, braces, shake-table records, sensors, and the nodes that run or simulate them.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "plant = abrace_node.executable:main",
            "ground_motion = abrace_node.executable:main",
            "record = abrace_node.executable:main",
            "characterize = abrace_node.executable:main",
            "check_sensors = abrace_node.executable:main",
            "sensor_bridge = abrace_node.executable:main",
            "emulator = abrace_node.executable:main",
        ]
    },
)
