# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="abrace_sysid",
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_sysid"]),
        ("share/abrace_sysid", ["package.xml"]),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="From bags of white-noise tests to state-space models: excitation, identification, validation.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "ambient = abrace_core.executable:main",
            "excitation = abrace_core.executable:main",
            "identify = abrace_core.executable:main",
            "validate = abrace_core.executable:main",
        ]
    },
)
