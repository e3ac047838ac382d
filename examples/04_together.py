"""Four devices of this machine train one model: gradients travel, photographs stay."""

import shutil

from town_photographs import LONG_SIDE_PX, OUT, PHOTOGRAPHS, STEPS, save_picture

import radiant

folder = OUT / "together"
shutil.rmtree(folder, ignore_errors=True)
(OUT / "04_system.toml").parent.mkdir(parents=True, exist_ok=True)
(OUT / "04_system.toml").write_text("".join(f'[[edge]]\nid = "e{n}"\ndevice = [{{ id = "d{n}1" }}, {{ id = "d{n}2" }}]\n' for n in (1, 2)))
config = radiant.RunConfig(
    source=PHOTOGRAPHS,
    out=folder,
    system=OUT / "04_system.toml",
    plan=radiant.PlanOptions(devices="all", within_edge="together", between_edges="together"),
    train=radiant.TrainOptions(long_side_px=LONG_SIDE_PX, num_steps=STEPS // 4),
)
with radiant.progress(decisions=True) as listen:
    result = radiant.run(config, listen)
print(f"{result.metrics['psnr_db']:.2f} dB, {result.report}")

scene = radiant.load_scene(folder)
held_out = scene.views("held_out", LONG_SIDE_PX)
view = next(radiant.render(result.load_splats(), held_out.cameras))
save_picture("04_together.png", held_out.images[0] / 255, view.image)
