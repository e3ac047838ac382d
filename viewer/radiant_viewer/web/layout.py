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
STYLE = """
html, body { overflow: hidden !important; }
/* The panel is as wide as makes a photograph of 4:3 fill it, below 90 px for its name, figures and buttons. */
:root { --rad-lower: clamp(300px, 43.5vh, 640px); --rad-panel: calc((var(--rad-lower) - 90px) * 4 / 3 + 16px); }
.rad-bar .v-toolbar__content { gap: 4px; }
.rad-legend { font-size: 12px; line-height: 18px; padding: 0 8px 0 46px; opacity: .85; display: flex; align-items: center; gap: 7px; }
.rad-legend span.text { overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
.rad-swatch { flex: none; width: 12px; height: 12px; border: 1px solid rgba(110,118,130,.9); }
.rad-swatch.line { height: 4px; border: none; }
.rad-swatch.dot, .rad-swatch.ring { border-radius: 50%; }
.rad-swatch.dot { border: none; width: 8px; height: 8px; margin: 0 2px; }
.rad-heat { height: 10px; border: 1px solid rgba(110,118,130,.6); }
.rad-layer { display: flex; align-items: center; padding: 0 6px 0 6px; }
.rad-layer .v-selection-control { flex: 1 1 auto; }
.rad-layer .v-label { white-space: nowrap; font-size: 13px; opacity: 1; }
.rad-pane { position: relative; flex: 1 1 0; min-width: 0; height: 100%; overflow: hidden; }
.rad-pane .rad-name { position: absolute; left: 8px; top: 6px; z-index: 2; font-size: 12px; font-weight: 600; padding: 1px 7px;
  border-radius: 4px; pointer-events: none; background: rgba(var(--v-theme-surface), .82); }
.rad-pane.rad-second { border-left: 1px solid rgba(128,128,128,.35); }
.rad-pane iframe { position: absolute; inset: 0; width: 100%; height: 100%; border: 0; z-index: 1; visibility: hidden; }
/* The frame says so itself, once it has drawn. */
.rad-pane iframe[data-loaded] { visibility: visible; }
.rad-pane .rad-drawn { position: absolute; right: 8px; top: 5px; z-index: 2; }
.rad-tab { flex: 1 1 0; min-height: 0; overflow: auto; }
.rad-table table { font-size: 12.5px; }
.rad-table th, .rad-table tr[data-camera] td,
.rad-table tr[data-seam] td { height: 28px !important; padding: 0 10px !important; white-space: nowrap; }
.rad-table td { font-variant-numeric: tabular-nums; cursor: pointer; }
.rad-table tr.chosen td { background: rgba(var(--v-theme-primary), .22); }
.rad-table tbody tr:hover td { background: rgba(var(--v-theme-primary), .10); }
.rad-panel { flex: none; width: var(--rad-panel); border-left: 1px solid rgba(128,128,128,.35); }
.rad-photo { position: relative; flex: 1 1 0; min-height: 0; display: flex; align-items: center; justify-content: center; }
.rad-photo img { position: absolute; left: 0; top: 0; width: 100%; height: 100%; object-fit: contain; }
.rad-slider { position: absolute; left: 6px; right: 6px; bottom: 4px; margin: 0 !important; border-radius: 12px;
  background: rgba(var(--v-theme-surface), .72); }
.rad-soft { font-size: 12px; opacity: .75; }
.rad-figure { font-size: 11px; line-height: 16px; white-space: nowrap; }
.rad-figure b { font-variant-numeric: tabular-nums; }
"""


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
        with v3.VMain(classes="fill-height"), html.Div(classes="d-flex flex-column", style="height: calc(100vh - 45px)"):
            images = _views(page)
            _lower_half()
    return images


def _button(icon: str, tip: str, click: str, **attributes: Any) -> None:
    v3.VBtn(icon=icon, title=tip, click=click, density="comfortable", size="small", variant="text", **attributes)


def _bar() -> None:
    with v3.VAppBar(flat=True, border=True, height=44, classes="rad-bar"):
        html.Div("{{ title }}", classes="ml-4 font-weight-bold text-no-wrap")
        html.Div("{{ subtitle }}", classes="rad-soft ml-2 text-truncate")
        v3.VSpacer()
        with v3.VBtnToggle(v_model=("panes",), mandatory=True, density="compact", variant="outlined", divided=True, style="height: 30px"):
            for value, text in (("map", "Map"), ("both", "Both"), ("view", "3D")):
                v3.VBtn(text, value=value, size="small", classes="text-none", raw_attrs=[f'data-pane="{value}"'])
        _button("mdi-fit-to-screen-outline", "Fit all layers into both views", "trigger('fit')", classes="ml-2")
        _button("mdi-theme-light-dark", "Light or dark", "dark = !dark", raw_attrs=['data-action="theme"'])


def _layer_drawer() -> None:
    with v3.VNavigationDrawer(permanent=True, width=280), html.Div(classes="py-2"):
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
    with html.Div(classes="d-flex", style="flex: 1 1 0; min-height: 0"):
        for name, view, other in (("Map", page.scene.map, "view"), ("3D", page.scene.view, "map")):
            second = " rad-second" if name == "3D" else ""
            with html.Div(v_show=f"panes !== '{other}'", classes=f"rad-pane{second}", raw_attrs=[f'data-view="{name}"']):
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
    with html.Div(classes="d-flex", style="height: var(--rad-lower); border-top: 1px solid rgba(128,128,128,.35)"):
        with html.Div(classes="d-flex flex-column", style="flex: 1 1 0; min-width: 0"):
            with v3.VTabs(v_model=("tab",), density="compact", height=34, color="primary"):
                for value, text in (("cameras", "Cameras"), ("seams", "Seams, worst first"), ("plan", "Plan and times")):
                    v3.VTab(text, value=value, classes="text-none", raw_attrs=[f'data-tab="{value}"'])
            _camera_table()
            _seam_tour()
            with html.Div(v_show="tab === 'plan'", classes="rad-tab pa-2"):
                html.Img(v_if="gantt", src=("gantt",), style="max-width: 100%; background: white", alt="Gantt chart of plan and run")
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
                for text in ("Border", "Colour step (levels of 255)", "Texture beside it", "Worst piece", "Observed", "Verdict"):
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
    with html.Div(
        classes="d-flex flex-column pa-2", style="flex: none; width: var(--rad-panel); border-left: 1px solid rgba(128,128,128,.35)"
    ):
        html.Div("Choose a camera to see its photograph, render and difference.", v_if="selected === null", classes="rad-soft pa-2")
        with html.Template(v_if="selected !== null"):
            with html.Div(classes="d-flex align-center"):
                html.Div("{{ cameras[selected].name }}", classes="text-body-2 font-weight-bold text-truncate", raw_attrs=["data-chosen"])
                v3.VSpacer()
                _button(
                    "mdi-video-outline", "Look from where this camera stood", "trigger('fly_to_camera')", raw_attrs=['data-action="fly"']
                )
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
