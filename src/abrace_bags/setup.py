# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="abrace_bags",
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_bags"]),
        ("share/abrace_bags", ["package.xml"]),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="MCAP bags of the rig: recorded, read as arrays, recovered, replayed.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "logger = abrace_core.executable:main",
            "recover = abrace_core.executable:main",
            "replay = abrace_core.executable:main",
        ]
    },
)
