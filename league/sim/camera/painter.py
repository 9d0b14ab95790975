"""Paints one scene with OpenCV: the floor as a warp, then walls and things as convex polygons.

The fastest way found on a CPU: projection is one small matrix product for each thing, all faces of
all eyes are rounded and gathered at once, and only what the camera can see is filled. Points
go to OpenCV in 1/16 pixel.
"""

import math
from functools import cmp_to_key

import cv2
import numpy as np

from league.sim.camera.ground import Band, Ground
from league.sim.camera.lens import Lens, Pose
from league.sim.camera.scene import BOX, CAR, FAR_CAR, SKY_COLOUR, WALL_HEIGHT, is_far, lit, luma
from league.sim.camera.shapes import SHAPES, Placed
from league.sim.camera.stage import Thing

NEAR = 0.02
"""Nothing nearer than this is seen [m]."""

SHIFT = 4
_UNIT = 1 << SHIFT
_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_REACH = 0.27
"""No part of a car is farther from its middle [m], in the plane."""
