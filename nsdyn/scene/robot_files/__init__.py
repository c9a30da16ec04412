"""Readers of robot files: each turns a file into a `Description` and reports the contents that are not used."""

from nsdyn.scene.robot_files.mjcf import read_mjcf
from nsdyn.scene.robot_files.model import read_model
from nsdyn.scene.robot_files.sdf import read_sdf
from nsdyn.scene.robot_files.urdf import read_urdf

__all__ = ["read_mjcf", "read_model", "read_sdf", "read_urdf"]
