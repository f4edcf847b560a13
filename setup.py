"""What pyproject.toml cannot say: folders outside of the package are installed inside it."""

from setuptools import find_packages, setup

OUTSIDE = {"ndf_mi.plugins": "plugins", "ndf_mi.scenes": "scenes", "ndf_mi.stability": "tests/stability"}

setup(
    packages=sorted({*find_packages(include=["ndf_mi", "ndf_mi.*"]), *OUTSIDE}),
    package_dir=OUTSIDE,
    package_data={
        "ndf_mi": ["py.typed"],
        "ndf_mi.body": ["data/*"],
        "ndf_mi.reports": ["style.css", "templates/*"],
        "ndf_mi.scenes": ["*"],
    },
)
