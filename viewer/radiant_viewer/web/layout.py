"""The layout of the page in Vuetify: layers left, map and 3D view, tables and pictures below.

Built once per server. Names in quotes with `trigger` are methods of the page; all others are its
state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from trame.ui.vuetify3 import VAppLayout
from trame.widgets import client, html, vtk
from trame.widgets import vuetify3 as v3

from radiant_viewer.layers.themes import DARK, LIGHT, Theme, hex_color
from radiant_viewer.web.style import NARROW_PX, STYLE

NARROW = f"$vuetify.display.width < {NARROW_PX}"
"""Whether the page is on a phone, for the browser to say."""

HEADERS = {
    # Vue compiles its templates in the browser; all files come from this machine.
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws: wss: blob: data:; worker-src 'self' blob:; "
        "frame-ancestors 'self'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class PageActions(Protocol):
    """The actions of the page that the layout calls."""

    scene: Any
    fit: Callable[[], None]
    select_camera: Callable[[int], None]
    fly_to_camera: Callable[[], None]
    go_to_seam: Callable[[int], None]
    toggle_solo: Callable[[str], None]


def vuetify_theme(theme: Theme) -> dict[str, Any]:
    """Return a theme's colours under Vuetify's names."""
    names = {"background": theme.panel, "surface": theme.field, "primary": theme.accent}
    return {"dark": theme.name == "dark", "colors": {name: hex_color(color) for name, color in names.items()}}


def build_layout(server: Any, page: PageActions) -> tuple[Any, Any]:
    """Build the page; returns the widgets of map and 3D view, whose `update` sends a frame."""
    for name in ("fit", "select_camera", "fly_to_camera", "go_to_seam", "toggle_solo"):
        server.trigger(name)(getattr(page, name))
    config = {"theme": {"defaultTheme": "light", "themes": {theme.name: vuetify_theme(theme) for theme in (LIGHT, DARK)}}}
    with VAppLayout(server, vuetify_config=config, theme=("dark ? 'dark' : 'light'",), full_height=True):
        client.Style(STYLE)
        _bar()
        _layer_drawer()
        with v3.VMain(classes="fill-height"), html.Div(classes="rad-whole"):
            images = _views(page)
            _lower_half()
    return images


def _button(icon: str, tip: str, click: str, **attributes: Any) -> None:
    v3.VBtn(icon=icon, title=tip, click=click, density="comfortable", size="small", variant="text", **attributes)


def _bar() -> None:
    with v3.VAppBar(flat=True, border=True, height=44, classes="rad-bar"):
        _button("mdi-layers-outline", "Layers", "drawer = !drawer", v_if=(NARROW,), classes="ml-1", raw_attrs=['data-action="layers"'])
        html.Div("{{ title }}", classes="ml-4 font-weight-bold text-no-wrap")
        html.Div("{{ subtitle }}", classes="rad-subtitle rad-soft ml-2 text-truncate")
        v3.VSpacer()
        with v3.VBtnToggle(v_model=("panes",), mandatory=True, density="compact", variant="outlined", divided=True, style="height: 30px"):
            for value, text in (("map", "Map"), ("both", "Both"), ("view", "3D")):
                v3.VBtn(text, value=value, size="small", classes="text-none", raw_attrs=[f'data-pane="{value}"'])
        _button(
            "mdi-fit-to-screen-outline", "Fit all layers into both views", "trigger('fit')", classes="ml-2", raw_attrs=['data-action="fit"']
        )
        _button("mdi-theme-light-dark", "Light or dark", "dark = !dark", raw_attrs=['data-action="theme"'])


def _layer_drawer() -> None:
    """Beside the views, or on a phone a sheet from below."""
    with v3.VNavigationDrawer(v_if=(f"!({NARROW})",), permanent=True, width=280):
        _layer_list()
    # What Vuetify calls the width of a drawer at the bottom is its height.
    height = ("Math.round(0.62 * $vuetify.display.height)",)
    with v3.VNavigationDrawer(v_if=(NARROW,), v_model=("drawer",), temporary=True, location="bottom", width=height):
        _layer_list()


def _layer_list() -> None:
    with html.Div(classes="py-2"):
        html.Div("Layers", classes="text-subtitle-2 font-weight-bold px-3 pb-1")
        with html.Div(v_for="layer in layers", key="layer.name", classes="pb-1", raw_attrs=[':data-layer="layer.name"']):
            with html.Div(classes="rad-layer"):
                v3.VCheckboxBtn(
                    v_model=("visible",), value=("layer.name",), label=("layer.name",), density="compact", color="primary", multiple=True
                )
                v3.VBtn(
                    "solo",
                    title="Show this layer alone; again brings the others back",
                    click="trigger('toggle_solo', [layer.name])",
                    size="x-small",
                    variant=("solo === layer.name ? 'flat' : 'text'",),
                    color=("solo === layer.name ? 'primary' : undefined",),
                    classes="text-none",
                )
            with html.Div(v_if="visible.includes(layer.name)"):
                _legend()


def _legend() -> None:
    with html.Div(v_for="entry in layer.legend.slice(0, 10)", classes="rad-legend", title=("entry.text",)):
        html.Span(classes=("'rad-swatch ' + entry.marker",), style=("{ background: entry.color }",))
        html.Span("{{ entry.text }}", classes="text")
    html.Div("… and {{ layer.legend.length - 10 }} more", v_if="layer.legend.length > 10", classes="rad-legend")
    html.Div("{{ layer.note }}", v_if="layer.note", classes="rad-legend", title=("layer.note",))
    with html.Div(v_if="layer.heat", style="padding: 2px 12px 2px 42px", classes="rad-soft"):
        html.Div("{{ layer.heat.label }}")
        html.Div(classes="rad-heat", style=("{ background: layer.heat.gradient }",))
        with html.Div(classes="d-flex justify-space-between"):
            html.Span("{{ layer.heat.low }}")
            html.Span("{{ layer.heat.high }}")


def _views(page: PageActions) -> tuple[Any, Any]:
    images = []
    with html.Div(classes="rad-views"):
        for name, view, hidden_when in (("Map", page.scene.map, "view"), ("3D", page.scene.view, "map")):
            second = " rad-second" if name == "3D" else ""
            with html.Div(v_show=f"panes !== '{hidden_when}'", classes=f"rad-pane{second}", raw_attrs=[f'data-view="{name}"']):
                html.Div(name, classes="rad-name")
                images.append(vtk.VtkRemoteView(view.plotter.render_window, interactive_quality=75, interactive_ratio=1, still_quality=94))
                if name == "3D":
                    _browser_splats()
    return images[0], images[1]


def _browser_splats() -> None:
    """The model drawn by the browser over the server's picture, and the button between the two."""
    html.Div("{{ splats_reason }}", v_if="splats_reason", classes="rad-soft rad-drawn")
    html.Iframe(
        v_if="splats_page",
        v_show="splats_shown",
        src=("splats_page",),
        title="The model",
        raw_attrs=[':data-told="JSON.stringify(splats_told)"', "data-splats"],
    )
    v3.VBtn(
        "{{ splats_shown ? 'Layers by depth' : 'Model' }}",
        v_if="splats_page",
        click="splats_shown = !splats_shown",
        title="The model, drawn by your browser, or the layers as the server draws them",
        size="x-small",
        variant="flat",
        classes="rad-drawn text-none",
        raw_attrs=['data-action="splats"'],
    )


def _lower_half() -> None:
    with html.Div(classes="rad-lower"):
        with html.Div(classes="d-flex flex-column", style="flex: 1 1 0; min-width: 0"):
            with v3.VTabs(v_model=("tab",), density="compact", height=34, color="primary"):
                for value, text in (("cameras", "Cameras"), ("seams", "Seams, worst first"), ("plan", "Plan and times")):
                    v3.VTab(text, value=value, classes="text-none", raw_attrs=[f'data-tab="{value}"'])
            _camera_table()
            _seam_tour()
            with html.Div(v_show="tab === 'plan'", classes="rad-tab pa-2"):
                html.Img(v_if="gantt", src=("gantt",), classes="rad-chart", alt="Gantt chart of plan and run")
                html.Div("The run has no times yet: there is no chart.", v_if="!gantt", classes="rad-soft pa-2")
        _pictures()


def _camera_table() -> None:
    v3.VDataTableVirtual(
        v_show="tab === 'cameras'",
        items=("order.map(index => cameras[index])",),
        headers=("headers",),
        # Written out: trame turns v_model_sort_by into v-model:sort.by, which binds nothing.
        sort_by=("sort_by",),
        update_sortBy="sort_by = $event",
        # The server sorts: the browser would take an empty cell for a small number.
        custom_key_sort=("Object.fromEntries(headers.map(header => [header.key, () => 0]))",),
        must_sort=True,
        density="compact",
        fixed_header=True,
        height="100%",
        item_value="index",
        item_height=28,
        hover=True,
        classes="rad-table",
        style="flex: 1 1 0; min-height: 0",
        raw_attrs=["@click:row=\"(event, row) => trigger('select_camera', [row.item.index])\""],
        row_props=("(row) => ({ class: row.item.index === selected ? 'chosen' : '', 'data-camera': row.item.name })",),
    )


def _seam_tour() -> None:
    with html.Div(v_show="tab === 'seams'", classes="rad-tab"):
        with html.Div(classes="d-flex align-center px-2 py-1", style="gap: 6px"):
            v3.VBtn(
                "Previous",
                click="trigger('go_to_seam', [seam - 1])",
                size="small",
                variant="outlined",
                classes="text-none",
                disabled=("seams.length < 1",),
            )
            v3.VBtn(
                "Next",
                click="trigger('go_to_seam', [seam + 1])",
                size="small",
                variant="outlined",
                classes="text-none",
                disabled=("seams.length < 1",),
            )
            html.Span(
                "{{ seams_note || (seam < 0 ? 'Next begins at the worst of ' + seams.length : (seam + 1) + ' of ' + seams.length) }}",
                classes="rad-soft",
            )
        with v3.VTable(density="compact", fixed_header=True, height="calc(var(--rad-lower) - 76px)", classes="rad-table"):
            with html.Thead(), html.Tr():
                for text in ("Border", "Step (of 255)", "Texture", "Worst piece", "Observed", "Verdict"):
                    html.Th(text)
            with (
                html.Tbody(),
                html.Tr(
                    v_for="stop in seams",
                    key="stop.index",
                    click="trigger('go_to_seam', [stop.index])",
                    classes=("stop.index === seam ? 'chosen' : ''",),
                    raw_attrs=[':data-seam="stop.title"'],
                ),
            ):
                for field in ("title", "step", "texture", "worst", "observed", "verdict"):
                    html.Td(f"{{{{ stop.{field} }}}}")


def _pictures() -> None:
    with html.Div(classes=("selected === null ? 'rad-panel rad-empty pa-2' : 'rad-panel pa-2'",)):
        html.Div("Choose a camera to see its photograph, render and difference.", v_if="selected === null", classes="rad-soft pa-2")
        with html.Template(v_if="selected !== null"):
            with html.Div(classes="d-flex align-center"):
                html.Div("{{ cameras[selected].name }}", classes="text-body-2 font-weight-bold text-truncate", raw_attrs=["data-chosen"])
                v3.VSpacer()
                _button(
                    "mdi-video-outline", "Look from where this camera stood", "trigger('fly_to_camera')", raw_attrs=['data-action="fly"']
                )
                _button("mdi-close", "Close", "selected = null", v_if=(NARROW,), raw_attrs=['data-action="close"'])
            with html.Div(classes="d-flex flex-wrap pb-1", style="gap: 0 9px", v_if="figures.length"):
                html.Span(
                    "{{ figure.heading }} <b>{{ figure.value }}</b>",
                    v_for="figure in figures",
                    key="figure.heading",
                    classes="rad-figure",
                    title=("figure.meaning",),
                )
            with v3.VBtnToggle(
                v_if="pictures.render",
                v_model=("kind",),
                mandatory=True,
                density="compact",
                variant="outlined",
                divided=True,
                style="height: 26px",
            ):
                for value, text in (("photograph", "Photograph"), ("render", "Render"), ("difference", "Difference"), ("slide", "Slider")):
                    v3.VBtn(text, value=value, size="x-small", classes="text-none", raw_attrs=[f'data-kind="{value}"'])
            with html.Div(classes="rad-photo mt-1", v_if="pictures.photograph"):
                html.Img(src=("pictures[kind === 'slide' || !pictures.render ? 'photograph' : kind]",), alt="Picture of the chosen camera")
                html.Img(
                    v_if="kind === 'slide' && pictures.render",
                    src=("pictures.render",),
                    alt="Render over the photograph",
                    style=("{ clipPath: 'inset(0 0 0 ' + share + '%)' }",),
                )
                v3.VSlider(
                    v_if="kind === 'slide' && pictures.render",
                    v_model=("share",),
                    min=0,
                    max=100,
                    hide_details=True,
                    density="compact",
                    color="primary",
                    classes="rad-slider",
                    title="Photograph to the left, render to the right",
                )
            html.Div("{{ pictures.reason }}", v_if="pictures.reason", classes="rad-soft pt-1")
