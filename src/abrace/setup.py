# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace",
    version="1.0.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace"]),
        ("share/abrace", ["package.xml"]),
        ("share/abrace/campaigns", sorted(glob("campaigns/*.yaml"))),
        ("bin", ["scripts/abrace"]),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="The abrace command: nodes run as processes, campaigns of tests, reports, bags.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["supervisor = abrace_node.executable:main"]},
)
