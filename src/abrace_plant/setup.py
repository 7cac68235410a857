# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace_plant",
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_plant"]),
        ("share/abrace_plant", ["package.xml"]),
        ("share/abrace_plant/config", sorted(glob("config/*.yaml"))),
        ("share/abrace_plant/config/frames", sorted(glob("config/frames/*.yaml"))),
        ("share/abrace_plant/config/devices", sorted(glob("config/devices/*.yaml"))),
        ("share/abrace_plant/config/device_parts", sorted(glob("config/device_parts/*.yaml"))),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="The laboratory: building, braces, shake-table records, sensors, and the nodes that run or simulate them.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "plant = abrace_core.executable:main",
            "ground_motion = abrace_core.executable:main",
            "record = abrace_core.executable:main",
            "characterize = abrace_core.executable:main",
            "robot_description = abrace_core.executable:main",
            "check_sensors = abrace_core.executable:main",
            "sensor_bridge = abrace_core.executable:main",
            "emulator = abrace_core.executable:main",
            "jitter = abrace_core.executable:main",
        ]
    },
)
