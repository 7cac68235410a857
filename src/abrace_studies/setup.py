# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name="abrace_studies",
    version="1.0.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/abrace_studies"]),
        ("share/abrace_studies", ["package.xml"]),
        ("share/abrace_studies/benchmarks", sorted(glob("benchmarks/*.yaml"))),
        ("share/abrace_studies/frames", sorted(glob("frames/*.yaml"))),
    ],
    zip_safe=True,
    maintainer="abrace developers",
    maintainer_email="maintainers@abrace.example.org",
    description="Studies of many closed loops: exploration of weights, fragility, benchmark buildings.",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
