"""Package of the node for colcon; planopt itself is installed with pip."""

from setuptools import setup

setup(
    name="planopt_contact",
    version="0.2.0",
    packages=["planopt_contact"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/planopt_contact"]),
        ("share/planopt_contact", ["package.xml"]),
    ],
    entry_points={"console_scripts": ["contact = planopt_contact.contact_node:main"]},
)
