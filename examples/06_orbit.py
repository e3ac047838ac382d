"""Views that nobody flew: an orbit around the middle of the scene."""

import numpy as np
from town_photographs import LONG_SIDE_PX, STEPS, save_picture, town

import radiant

scene = town()
splats = radiant.train(scene, num_steps=STEPS, long_side_px=LONG_SIDE_PX).splats

middle = np.median(scene.points, axis=0)
height = float(np.median(scene.cameras.centers[:, 2]) - middle[2])
lens = radiant.Lens(size_wh=(LONG_SIDE_PX, LONG_SIDE_PX * 3 // 4), field_of_view_deg=60)
frames = radiant.orbit(middle, radius=1.2 * height, elevation_deg=40, num_frames=4, lens=lens)
save_picture("06_orbit.png", *(view.image for view in radiant.render(splats, frames)))
