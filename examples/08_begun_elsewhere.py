"""A scene whose poses another program found: a COLMAP project is taken as it stands."""

import shutil

from town_photographs import LONG_SIDE_PX, OUT, ROOT, STEPS, save_picture

import radiant

# images/ and sparse/0/, as COLMAP leaves them; here those of the hamlet with its true cameras.
project, folder = OUT / "hamlet_project", OUT / "hamlet"
for path in (project, folder):
    shutil.rmtree(path, ignore_errors=True)
shutil.copytree(ROOT / "sample_scenes/hamlet/images", project / "images")
shutil.copytree(ROOT / "sample_scenes/hamlet/known", project / "sparse/0")

scene = radiant.reconstruct(project, folder)
print(scene)
result = radiant.train(scene, num_steps=STEPS, long_side_px=LONG_SIDE_PX)
print(radiant.evaluate(result.splats, scene, long_side_px=LONG_SIDE_PX))
held_out = scene.views("held_out", LONG_SIDE_PX)
view = next(radiant.render(result.splats, held_out.cameras))
save_picture("08_begun_elsewhere.png", held_out.images[0] / 255, view.image)
