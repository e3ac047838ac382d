"""Photographs to one model: poses, training, figures on photographs that it never saw."""

from town_photographs import LONG_SIDE_PX, OUT, STEPS, save_picture, town

import radiant

scene = town()
print(scene)
with radiant.progress() as listen:
    result = radiant.train(scene, num_steps=STEPS, long_side_px=LONG_SIDE_PX, listen=listen)
print(result)
print(radiant.evaluate(result.splats, scene, long_side_px=LONG_SIDE_PX))

radiant.save_splats(result.splats, OUT / "town.ply")  # opens in every viewer of Gaussians
held_out = scene.views("held_out", LONG_SIDE_PX)
view = next(radiant.render(result.splats, held_out.cameras))
save_picture("01_one_model.png", held_out.images[0] / 255, view.image)
