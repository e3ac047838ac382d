"""`VtkRenderer`: a model drawn by VTK's `vtkPointGaussianMapper`, colour and depth in one picture,
as `ModelRenderer` draws it. Twice per frame of a view, where `choosing` found it the faster one.

    first   Σ w_i c_i and Σ w_i    colours along the view, blended far to near in float32
    second  Σ w_i z_i              depths as the three bytes of a colour: blending is linear

N Gaussians, H W px.
"""

from __future__ import annotations

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.util.vtkConstants import VTK_FLOAT
from vtkmodules.vtkCommonDataModel import vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPointGaussianMapper, vtkRenderer, vtkRenderWindow
from vtkmodules.vtkRenderingOpenGL2 import vtkFramebufferPass, vtkRenderStepsPass, vtkTextureObject

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.render.reach import Reach
from radiant_core.spherical_harmonics import sh_terms
from radiant_core.splats import Splats
from radiant_viewer.layers.depth_picture import OPAQUE, Rgbd
from radiant_viewer.pictures.offscreen import egl_rendering
from radiant_viewer.pictures.splat_picture import aim_as

DILATION_PX2 = 0.3
"""As every rasterizer here has it (`render/contract.py`): VTK by itself has none."""
DEPTH_BYTES = np.array([65536.0, 256.0, 1.0], np.float32)
DEEPEST = float(2**24 - 1)


# VTK leaves out what has its middle beside a window 1.3 times the picture; near an eye within the
# scene it is much of the picture. 3DGS draws it, projected as at the window's rim.
_JACOBIAN = "mat3 J = getProjectionMatrix(posVC.xyz);"
_JACOBIAN_WITHIN = """
vec2 reach = cameraParallel != 0 ? vec2(1e30) : -1.3 * posVC.z / vec2(VCDCMatrix[0][0], VCDCMatrix[1][1]);
mat3 J = getProjectionMatrix(vec3(clamp(posVC.xy, -reach, reach), posVC.z));
"""
_LEFT_OUT = "transformVCVSOutput = mat2(0);"


class VtkRenderer:
    """Renders one model by VTK, about its middle: graphics cards keep float32."""

    def __init__(self, splats: Splats) -> None:
        self._splats, self._reach = splats, Reach.of(splats)
        self._origin = splats.means.astype(np.float64).mean(axis=0)
        self._means = (splats.means - self._origin).astype(np.float32)
        self._scales = np.exp(splats.log_scales)
        self._quats = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
        self._opacities = np.rint(255 / (1 + np.exp(-splats.logit_opacities))).astype(np.uint8)
        self._cloud = vtkPolyData()
        self._mapper = vtkPointGaussianMapper()
        self._mapper.SetInputData(self._cloud)
        self._mapper.AnisotropicOn()
        self._mapper.EmissiveOff()
        self._mapper.SetScaleArray("scales")
        self._mapper.SetScaleFactor(1.0)
        self._mapper.SetScaleTableSize(0)
        self._mapper.SetRotationArray("quats")
        actor = vtkActor()
        actor.SetMapper(self._mapper)
        actor.ForceTranslucentOn()
        for old, new in ((_JACOBIAN, _JACOBIAN_WITHIN), (_LEFT_OUT, "")):
            actor.GetShaderProperty().AddVertexShaderReplacement(old, True, new, False)
        self._renderer, self._pass = vtkRenderer(), vtkFramebufferPass()
        self._pass.SetColorFormat(vtkTextureObject.Float32)
        self._pass.SetDepthFormat(vtkTextureObject.Float32)
        self._pass.SetDelegatePass(vtkRenderStepsPass())
        self._renderer.SetPass(self._pass)
        # Blended in the order of the points; without order pictures were 30 dB from ours.
        self._renderer.SetUseOIT(False)
        self._renderer.GetCullers().RemoveAllItems()
        self._renderer.AddActor(actor)
        with egl_rendering():
            self._window = vtkRenderWindow()
        self._window.SetOffScreenRendering(True)
        self._window.SetMultiSamples(0)
        self._window.AddRenderer(self._renderer)

    def draw(self, camera: Cameras, background: tuple[int, int, int], into: Rgbd) -> None:
        """Write the picture of one camera over a background (0 to 255): (H,W,4) float32, colours 0
        to 1 and depth in metres, 0 where the model fills less than `OPAQUE`. What lies far before
        the scene is left out."""
        width, height = (int(side) for side in camera.sizes_wh[0])
        axis, shift = camera.cam_from_world[0, 2, :3], camera.cam_from_world[0, 2, 3]
        depths = self._means @ axis.astype(np.float32) + np.float32(axis @ self._origin + shift)
        order = np.argsort(-depths, kind="stable")
        order = order[depths[order] > self._reach.near_m(camera)[0]]
        behind = np.array(background, np.float32) / 255
        if not len(order):
            into[..., :3], into[..., 3] = behind, 0
            return
        self._window.SetSize(width, height)
        self._mapper.SetLowpassMatrix(DILATION_PX2 * 4 / width**2, 0, DILATION_PX2 * 4 / height**2)
        self._aim(camera, float(depths[order[-1]]), float(depths[order[0]]))
        self._order(order)
        colors = self._blended(order, self._colors(camera.centers[0] - self._origin))
        low, span = np.float32(depths[order[-1]]), np.float32(max(float(np.ptp(depths[order])), 1e-6))
        places = self._blended(order, _bytes_of((depths - low) / span))
        alphas = colors[..., 3]
        into[..., :3] = np.clip(colors[..., :3] + (1 - alphas[..., None]) * behind, 0, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            into[..., 3] = np.where(alphas >= OPAQUE, low + span * (places[..., :3] @ DEPTH_BYTES) * (255 / DEEPEST) / alphas, 0)

    def _aim(self, camera: Cameras, near: float, far: float) -> None:
        eye = pv.Camera()
        aim_as(eye, camera, self._origin, 0.5 * near, 1.5 * far)
        self._renderer.SetActiveCamera(eye)

    def _order(self, order: NDArray[np.intp]) -> None:
        """Let VTK have the Gaussians in an order, but for their colours."""
        points = pv.vtk_points(self._means[order], deep=True)
        self._cloud.SetPoints(points)
        for name, values in (("scales", self._scales), ("quats", self._quats)):
            array = numpy_to_vtk(np.ascontiguousarray(values[order]), deep=True)
            array.SetName(name)
            self._cloud.GetPointData().AddArray(array)

    def _colors(self, eye: FloatArray) -> NDArray[np.uint8]:
        """Colours (N,3) seen from an eye (3,) relative to the origin."""
        degree, splats = self._splats.sh_degree, self._splats
        rays = self._means - eye.astype(np.float32)
        x, y, z = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).T
        terms = sh_terms(x, y, z, degree)
        colors = np.full((len(splats), 3), 0.5, np.float32)
        for index, term in enumerate(terms):
            colors += term[:, None] * (splats.sh0[:, 0] if index == 0 else splats.shN[:, index - 1])
        return np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8)

    def _blended(self, order: NDArray[np.intp], colors: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Blend colours (N,3) in an order: (H,W,4), the last Σ w."""
        scalars = numpy_to_vtk(np.column_stack([colors[order], self._opacities[order]]), deep=True)
        self._cloud.GetPointData().SetScalars(scalars)
        self._window.Render()
        texture = self._pass.GetColorTexture()
        width, height = texture.GetWidth(), texture.GetHeight()
        pixels = np.zeros((height, width, 4), np.float32)
        texture.Download().Download2D(VTK_FLOAT, pixels, [width, height], 4, [0, 0])
        return pixels[::-1]


def _bytes_of(shares: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Shares (N,) of a span as three bytes (N,3), the highest first."""
    steps = np.rint(np.clip(shares.astype(np.float64), 0, 1) * DEEPEST).astype(np.uint32)
    return np.stack([steps >> 16, (steps >> 8) & 255, steps & 255], axis=1).astype(np.uint8)
