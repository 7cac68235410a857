# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="abrace_bags",
    version="1.0.0",
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
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "logger = abrace_node.executable:main",
            "recover = abrace_node.executable:main",
            "replay = abrace_node.executable:main",
        ]
    },
)
