#!/usr/bin/env bash
# VTK: a wide Gaussian vanishes as a whole once its middle is 30 % beside the picture.
#
# `vtkPointGaussianMapper` draws anisotropic Gaussians as 3D Gaussian Splatting has them. The code of
# 3DGS projects one whose middle lies beside a window 1.3 times the picture as if it lay at the rim of
# that window, and draws it. VTK drops it, whatever of the picture it covers: one whose tail makes the
# rim three quarters white at 1.29 is gone at 1.31. From outside a scene nothing is missing; from
# within it, 24 dB of a picture of 3,000 Gaussians became 58 once the two lines of the vertex shader
# were replaced (`vtkShaderProperty.AddVertexShaderReplacement`).
# It matters to who walks through a trained scene in VTK.
# Seen on 2026-11-30 with VTK 9.7.2: "brightest pixel of 255, middle at 1.29: 189 at 1.31: 0".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "vtk==9.7.2" "numpy>=1.26,<3"
VTK_DEFAULT_OPENGL_WINDOW=vtkEGLRenderWindow "$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

WIDTH = HEIGHT = 64


def rim_brightness(across: float) -> int:
    """Of the brightest pixel, one Gaussian's middle so many half pictures from the middle."""
    points = vtk.vtkPoints()
    points.InsertNextPoint(10 * across * np.tan(np.radians(15)), 0, 0)
    cloud = vtk.vtkPolyData()
    cloud.SetPoints(points)
    for name, values in (("scales", [[1.0, 1, 1]]), ("quats", [[1.0, 0, 0, 0]])):
        array = numpy_to_vtk(np.array(values, np.float32), deep=True)
        array.SetName(name)
        cloud.GetPointData().AddArray(array)
    cloud.GetPointData().SetScalars(numpy_to_vtk(np.array([[255, 255, 255, 255]], np.uint8), deep=True))
    mapper = vtk.vtkPointGaussianMapper()
    mapper.SetInputData(cloud)
    mapper.AnisotropicOn()
    mapper.EmissiveOff()
    mapper.SetScaleArray("scales")
    mapper.SetScaleFactor(1.0)
    mapper.SetScaleTableSize(0)
    mapper.SetRotationArray("quats")
    actor = vtk.vtkActor()
    actor.SetMapper(mapper)
    actor.ForceTranslucentOn()
    renderer, window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
    renderer.SetUseOIT(False)
    renderer.GetCullers().RemoveAllItems()
    renderer.AddActor(actor)
    camera = renderer.GetActiveCamera()
    camera.SetPosition(0, 0, 10)
    camera.SetFocalPoint(0, 0, 0)
    camera.SetViewAngle(30)
    camera.SetClippingRange(0.1, 100)
    window.SetOffScreenRendering(True)
    window.SetSize(WIDTH, HEIGHT)
    window.AddRenderer(renderer)
    window.Render()
    pixels = vtk.vtkUnsignedCharArray()
    window.GetRGBACharPixelData(0, 0, WIDTH - 1, HEIGHT - 1, 0, pixels)
    return int(vtk_to_numpy(pixels).reshape(HEIGHT, WIDTH, 4)[..., 0].max())


print(f"VTK {vtk.vtkVersion().GetVTKVersion()}")
near, far = rim_brightness(1.29), rim_brightness(1.31)
print("brightest pixel of 255, middle at 1.29:", near, "at 1.31:", far)
# By the integral along the rays both differ by a few levels.
sys.exit(0 if near > 100 and far == 0 else 1)
PYTHON
