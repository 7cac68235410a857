# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace_bringup",
    version="1.0.0",
    packages=find_packages(),
    package_data={"abrace_bringup": ["page/files/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_bringup"]),
        ("share/abrace_bringup", ["package.xml"]),
        ("share/abrace_bringup/launch", sorted(glob("launch/*.launch.py"))),
        ("share/abrace_bringup/viewer", sorted(glob("viewer/*"))),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="Launch files for tests of the rig, and the page to watch and operate it.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "closed_loop = abrace_bringup.without_launch:main",
            "identification = abrace_bringup.without_launch:main",
            "policy = abrace_bringup.policy:main",
            "viewer = abrace_node.executable:main",
            "operator = abrace_node.executable:main",
        ]
    },
)
