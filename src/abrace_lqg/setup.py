# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace_lqg",
    version="1.0.0",
    packages=find_packages(),
    package_data={"abrace_lqg.export": ["c99/*"]},
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
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "design = abrace_node.executable:main",
            "controller = abrace_node.executable:main",
        ]
    },
)
