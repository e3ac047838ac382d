"""A flight planned before anything is photographed: who flies and computes which part."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from town_photographs import OUT

import radiant

# A grid of 400 waypoints over 250 by 125 m, and three machines of unequal speed at two edges.
east, north = np.meshgrid(np.linspace(0, 250, 25), np.linspace(0, 125, 16))
waypoints = np.stack([east.ravel(), north.ravel()], axis=1)
(OUT / "02_system.toml").parent.mkdir(parents=True, exist_ok=True)
(OUT / "02_system.toml").write_text("""
[[edge]]
id = "office"
position_m = [60.0, 60.0]
device = [{ id = "tower", relative_speed = 1.0 }, { id = "laptop", relative_speed = 0.5 }]
[[edge]]
id = "van"
position_m = [200.0, 60.0]
device = [{ id = "notebook", relative_speed = 0.4 }]
""")
plan = radiant.plan_regions(waypoints, radiant.load_system(OUT / "02_system.toml"))
print(plan)

figure, axes = plt.subplots(figsize=(8, 4.5))
for number, device in enumerate(plan.devices):
    rows = plan.cameras_of(device)
    axes.fill(*plan.strip_of(device).T, alpha=0.25, color=f"C{number}")
    axes.scatter(*waypoints[rows].T, s=6, color=f"C{number}", label=f"{device}: {len(rows)}")
axes.set(aspect="equal", xlabel="east, m", ylabel="north, m", title=f"done after {plan.makespan_s:.0f} s, as predicted")
axes.legend(loc="upper left", ncols=3, framealpha=1)
figure.savefig(OUT / "02_regions_before_capture.png", dpi=120)
print("written:", OUT / "02_regions_before_capture.png")
