"""A loss and an optimiser of one's own on the rasterizer: colours alone are fitted anew."""

import torch
from town_photographs import LONG_SIDE_PX, SMALL, STEPS, save_picture, town

import radiant

scene = town()
start = radiant.train(scene, num_steps=STEPS // 4, long_side_px=LONG_SIDE_PX).splats
views = scene.views("training", LONG_SIDE_PX)
splats = radiant.SplatTensors.from_splats(start)
splats.sh0.requires_grad_()
optimiser = torch.optim.Adam([splats.sh0], lr=5e-3)

order = torch.randperm(len(views), generator=torch.Generator().manual_seed(0)).tolist()
for step in range(10 if SMALL else 200):
    index = order[step % len(views)]
    width, height = views.cameras.sizes_wh[index].tolist()
    pose, K = (torch.tensor(array[index : index + 1]) for array in (views.cameras.cam_from_world, views.cameras.Ks))
    picture = radiant.rasterize(splats, pose, K, width, height, sh_degree=start.sh_degree).images[0]
    photograph = torch.tensor(views.images[index]) / 255
    # Charbonnier in place of L1 and SSIM.
    loss = ((picture - photograph).square() + 1e-4).sqrt().mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    if step % 50 == 0:
        print(f"step {step:3}, loss {float(loss):.4f}")

fitted = splats.to_splats()
for name, model in (("before", start), ("after", fitted)):
    print(f"{name:6}", radiant.evaluate(model, scene, long_side_px=LONG_SIDE_PX))
camera = scene.views("held_out", LONG_SIDE_PX).cameras.select([0])
save_picture("05_own_loss.png", *(next(radiant.render(model, camera)).image for model in (start, fitted)))
