"""An orthophoto and heights of a finished run, in metres."""

import shutil

import tifffile
from town_photographs import LONG_SIDE_PX, OUT, PHOTOGRAPHS, SMALL, STEPS, save_picture

import radiant

folder = OUT / "survey"
shutil.rmtree(folder, ignore_errors=True)
train = radiant.TrainOptions(long_side_px=LONG_SIDE_PX, num_steps=STEPS)
with radiant.progress() as listen:
    result = radiant.run(radiant.RunConfig(source=PHOTOGRAPHS, out=folder, train=train), listen)
print(f"{result.metrics['psnr_db']:.2f} dB on held-out photographs")

for kind in ("ortho", "dsm"):
    (OUT / f"07_{kind}.tif").unlink(missing_ok=True)
    written = radiant.export(folder, OUT / f"07_{kind}.tif", kind=kind, resolution=0.5 if SMALL else 0.1)
    print({name: figure for name, figure in written.items() if name != "decisions"})
save_picture("07_survey.png", tifffile.imread(OUT / "07_ortho.tif")[..., :3] / 255)
