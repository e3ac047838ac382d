#!/usr/bin/env bash
# VTK: `vtkCamera.DeepCopy` and `ShallowCopy` change a camera without raising its MTime.
#
# One would expect what every setter does: `SetPosition` to another place raises `GetMTime` and sends
# a ModifiedEvent, so that whoever caches by the camera's time, or listens to it, does its work again.
# After a copy the position is another one, the time is the old one, and no event is sent. The next
# picture is right, since the transforms inside have times of their own.
# It matters to everyone who links two views by copying cameras or who asks a camera whether it has
# moved: call `Modified()` after the copy.
# Seen on 2026-11-30 with VTK 9.7.2.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "vtk==9.7.2"
cd "$folder"
cat > seen.py <<'PY'
import sys

from vtkmodules.vtkCommonCore import vtkVersion
from vtkmodules.vtkRenderingCore import vtkCamera

print("VTK", vtkVersion.GetVTKVersion())
source = vtkCamera()
source.SetPosition(1, 2, 3)
changes = {
    "SetPosition": lambda camera: camera.SetPosition(1, 2, 3),
    "DeepCopy": lambda camera: camera.DeepCopy(source),
    "ShallowCopy": lambda camera: camera.ShallowCopy(source),
}
seen = []
for name, change in changes.items():
    camera, events = vtkCamera(), []
    camera.AddObserver("ModifiedEvent", lambda *_, events=events: events.append(1))
    before = camera.GetMTime()
    change(camera)
    is_later = camera.GetMTime() > before
    print(f"{name}: position {camera.GetPosition()}, MTime raised: {is_later}, ModifiedEvents: {len(events)}")
    seen.append((camera.GetPosition() == (1.0, 2.0, 3.0), is_later, bool(events)))
sys.exit(0 if seen == [(True, True, True), (True, False, False), (True, False, False)] else 1)
PY
"$folder/venv/bin/python" seen.py
