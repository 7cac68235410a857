# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace_lqg",
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_lqg"]),
        ("share/abrace_lqg", ["package.xml"]),
        ("share/abrace_lqg/config", sorted(glob("config/*.yaml"))),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="From models to LQG controllers with acceleration feedback, and the node that runs them at the rig's sample rate.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "design = abrace_core.executable:main",
            "controller = abrace_core.executable:main",
            "explore = abrace_core.executable:main",
        ]
    },
)
