# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace_bringup",
    version="0.1.0",
    packages=find_packages(),
    package_data={"abrace_bringup": ["operator_page/files/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_bringup"]),
        ("share/abrace_bringup", ["package.xml"]),
        ("share/abrace_bringup/launch", sorted(glob("launch/*.launch.py"))),
        ("share/abrace_bringup/config", sorted(glob("config/*.xml"))),
        ("share/abrace_bringup/viewer", sorted(glob("viewer/*"))),
        ("lib/abrace_bringup", ["scripts/make_keystore"]),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="Launch files for the rig, and the operator's page.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "closed_loop = abrace_bringup.without_launch:closed_loop",
            "identification = abrace_bringup.without_launch:identification",
            "viewer = abrace_core.executable:main",
            "operator = abrace_core.executable:main",
        ]
    },
)
