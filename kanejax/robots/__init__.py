"""Mechanisms of the literature as code: `kanejax.robots.intelledex_605()` and others return models; and files of real robots."""

from kanejax.robots.example_file import example_file as example_file
from kanejax.robots.intelledex_605 import intelledex_605 as intelledex_605
from kanejax.robots.rrp_arm import rrp_arm as rrp_arm
from kanejax.robots.stanford_arm import stanford_arm as stanford_arm
from kanejax.robots.three_revolute_arm import three_revolute_arm as three_revolute_arm
