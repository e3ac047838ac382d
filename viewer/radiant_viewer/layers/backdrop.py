"""`Backdrop`: a rendered model behind and between the layers of a plotter, by depth.

A picture (H,W,4) holds colour over the background and depth along the view, metres, 0 where nothing
was hit. A quad over the whole view shows it and writes its depth into the z-buffer, so that layers
before a wall cover it and layers behind it vanish. Once per frame: one upload of 16 bytes a pixel.
"""

from __future__ import annotations

import numpy as np
import pyvista as pv
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkCommand
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkRenderingCore import vtkPolyDataMapper, vtkTexture

from radiant_viewer.layers.depth_picture import Rgbd

_CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
_PLACE = "gl_Position = vec4(vertexMC.xy, 0.0, 1.0);\n"
# Colours are interpolated where the picture is coarse; depths never are: between a roof and the
# ground behind it there is nothing.
_COLOR = """
vec2 at = (gl_FragCoord.xy / viewWH - 0.5) * pictureScale + 0.5 + pictureShift;
vec2 flipped = vec2(at.x, 1.0 - at.y);
vec4 nearest = texelFetch(model, ivec2(clamp(flipped, 0.0, 0.99999) * vec2(textureSize(model, 0))), 0);
vec3 shade = isCoarse > 0.5 ? texture(model, flipped).rgb : nearest.rgb;
bool outside = any(lessThan(at, vec2(0.0))) || any(greaterThan(at, vec2(1.0)));
gl_FragData[0] = vec4(outside ? ground : shade, 1.0);
"""
# Layers in front of all others lie below a depth of 0.001 (`FRONT_SHADER`).
_DEPTH = """
float modelDepth = nearest.a;
gl_FragDepth = modelDepth <= 0.0 || outside ? 0.999999 : clamp(0.5 + 0.5 * (ndcOfDepth.x + ndcOfDepth.y / modelDepth), 0.0011, 0.999999);
"""


class Backdrop:
    """One picture behind the layers of `plotter`; nothing until `show`."""

    def __init__(self, plotter: pv.Plotter) -> None:
        self._plotter = plotter
        self._image = vtkImageData()
        self._picture: Rgbd | None = None
        texture = vtkTexture()
        texture.SetInputData(self._image)
        texture.SetColorModeToDirectScalars()
        texture.InterpolateOn()
        quad = pv.PolyData(_CORNERS, faces=np.array([4, 0, 1, 2, 3]))
        quad.active_texture_coordinates = (_CORNERS[:, :2] + 1) / 2
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(quad)
        self._actor = pv.Actor(mapper=mapper)
        self._actor.prop.lighting = False
        self._actor.prop.SetTexture("model", texture)
        # Its fourth channel is no opacity, and it fills every view.
        self._actor.ForceOpaqueOn()
        self._actor.UseBoundsOff()
        self._actor.PickableOff()
        self._actor.SetVisibility(False)
        shader = self._actor.GetShaderProperty()
        shader.AddVertexShaderReplacement("//VTK::PositionVC::Impl", True, _PLACE, False)
        shader.AddFragmentShaderReplacement("//VTK::TCoord::Impl", True, _COLOR + _DEPTH, False)
        self._uniforms = shader.GetFragmentCustomUniforms()
        self._uniforms.SetUniformf("isCoarse", 0.0)
        self.place((0.0, 0.0), (1.0, 1.0), (255, 255, 255))
        self._fit_to_view()
        plotter.renderer.AddActor(self._actor)
        # They go by where the quad's corners are in the world, and would leave it out.
        plotter.renderer.GetCullers().RemoveAllItems()
        plotter.renderer.AddObserver(vtkCommand.StartEvent, self._fit_to_view)

    @property
    def picture(self) -> Rgbd | None:
        """What is shown, or None."""
        return self._picture if self._actor.GetVisibility() else None

    def show(self, picture: Rgbd, *, is_coarse: bool = False) -> None:
        """Show a picture (H,W,4), which is not copied, scaled to the view; smoothly if coarse."""
        height, width = picture.shape[:2]
        self._picture = picture
        self._image.SetDimensions(width, height, 1)
        self._image.GetPointData().SetScalars(numpy_to_vtk(picture.reshape(-1, 4)))
        self._image.Modified()
        self._uniforms.SetUniformf("isCoarse", float(is_coarse))
        self._actor.SetVisibility(True)

    def hide(self) -> None:
        """Show the background alone."""
        self._actor.SetVisibility(False)

    def place(self, shift: tuple[float, float], scale: tuple[float, float], ground: tuple[int, int, int]) -> None:
        """Show another part of the picture: the view's middle at `shift`, shares of the picture
        from its middle, `scale` of its width and height across; `ground` (0 to 255) beyond it."""
        self._uniforms.SetUniform2f("pictureShift", shift)
        self._uniforms.SetUniform2f("pictureScale", scale)
        red, green, blue = (level / 255 for level in ground)
        self._uniforms.SetUniform3f("ground", (red, green, blue))

    def _fit_to_view(self, *_: object) -> None:
        width, height = self._plotter.renderer.GetSize()
        self._uniforms.SetUniform2f("viewWH", (float(max(width, 1)), float(max(height, 1))))
        near, far = self._plotter.renderer.GetActiveCamera().GetClippingRange()
        self._uniforms.SetUniform2f("ndcOfDepth", ((far + near) / (far - near), -2 * far * near / (far - near)))
