"""What pyproject.toml cannot say: two folders at the top are installed inside the package."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["ndf_mi", "ndf_mi.*"]), "ndf_mi.plugins", "ndf_mi.scenes"],
    package_dir={"ndf_mi.plugins": "plugins", "ndf_mi.scenes": "scenes"},
    package_data={
        "ndf_mi": ["py.typed"],
        "ndf_mi.body": ["data/*"],
        "ndf_mi.reports": ["style.css", "templates/*"],
        "ndf_mi.scenes": ["*"],
    },
)
