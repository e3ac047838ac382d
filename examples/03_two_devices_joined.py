"""Two machines train halves of a scene; their models are joined, their photographs stay."""

from town_photographs import LONG_SIDE_PX, STEPS, save_picture, town

import radiant

scene = town()
plan = radiant.plan_regions(scene, radiant.even_system(1, 2))

models = []
with radiant.progress() as listen:
    for device in plan.devices:
        rows = scene.indices("training")[plan.cameras_of(device)]
        result = radiant.train(scene, rows=rows, num_steps=STEPS, long_side_px=LONG_SIDE_PX, listen=listen)
        models.append((result.splats, scene.cameras.select(rows)))
    joined = radiant.join(models, listen, long_side_px=LONG_SIDE_PX)
for name, splats in (("first device", models[0][0]), ("second device", models[1][0]), ("joined", joined)):
    print(f"{name:14}", radiant.evaluate(splats, scene, long_side_px=LONG_SIDE_PX))

camera = scene.views("held_out", LONG_SIDE_PX).cameras.select([1])
save_picture("03_two_devices_joined.png", *(next(radiant.render(each, camera)).image for each in (models[0][0], models[1][0], joined)))
