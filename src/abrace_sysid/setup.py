# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="abrace_sysid",
    version="1.0.0",
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
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "ambient = abrace_node.executable:main",
            "excitation = abrace_node.executable:main",
            "identify_data = abrace_node.executable:main",
            "identify = abrace_node.executable:main",
            "validate = abrace_node.executable:main",
        ]
    },
)
