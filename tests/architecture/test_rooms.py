"""A short module with one importer joins it, unless it stands for an idea: these do, and for which."""

from __future__ import annotations

from tests.architecture.test_imports import PACKAGES, imports_within, modules_of

SHORT = 90
IDEAS: dict[str, tuple[str, ...]] = {
    "a part of the stable surface": ("radiant.plans", "radiant.showing"),
    "how one group of commands is typed": ("radiant_app.cli.streams", "radiant_app.cli.survey"),
    "one command": (
        "radiant_app.commands.export.ortho",
        "radiant_app.commands.export.project",
        "radiant_app.commands.network.packs",
        "radiant_viewer.open3d_window.launch",
    ),
    "one format of files": (
        "radiant_app.files.score_file",
        "radiant_core.export.mesh_glb",
        "radiant_core.export.mesh_ply",
        "radiant_core.export.point_cloud",
        "radiant_core.io.colmap.binary_writer",
        "radiant_core.io.flight.kml",
        "radiant_core.io.flight.qgc",
        "radiant_core.io.panoramas.recognise",
        "radiant_core.io.photos.xmp",
        "radiant_core.io.photos.xmp_position",
        "radiant_core.io.poses.polycam",
        "radiant_core.io.splat_file",
        "radiant_core.waypoints.wpml_heights",
        "radiant_viewer.runs.field_files",
    ),
    "one section of a report, or a page": (
        "radiant_app.report.added_page",
        "radiant_app.report.change_page",
        "radiant_app.report.gaps",
        "radiant_app.report.known_section",
        "radiant_app.report.phone",
    ),
    "who works, where photographs are, what is promised": (
        "radiant_app.run.groups",
        "radiant_app.run.here",
        "radiant_app.run.promises",
        "radiant_app.run.uncaptured",
        "radiant_app.workers.groups",
    ),
    "one way to join, and when it is taken": ("radiant_core.aggregate.cloud_choice", "radiant_core.aggregate.crop_merge"),
    "one law, with tests of its own": (
        "radiant_app.commands.plan.optics",
        "radiant_core.geometry.surface_matches",
        "radiant_core.georef.control_guess",
        "radiant_core.georef.given_world",
        "radiant_core.light.evenness",
        "radiant_core.plan.counts.slack",
        "radiant_core.plan.profiles.profile_warnings",
        "radiant_core.sfm.colmap.other_lenses",
        "radiant_core.sfm.control.marked",
        "radiant_core.sfm.control.place",
        "radiant_core.sfm.control.scale",
        "radiant_core.sfm.gps_outliers",
        "radiant_core.sfm.masks_in_use",
        "radiant_core.sfm.panorama_poses",
        "radiant_core.sfm.quick.features",
        "radiant_core.sfm.readable",
        "radiant_core.sfm.world_frame.altitudes",
        "radiant_core.sfm.world_frame.known_sizes",
        "radiant_core.sfm.world_frame.position_count",
        "radiant_core.survey.height_mesh",
        "radiant_core.survey.sight",
        "radiant_core.train.held",
        "radiant_core.train.step_costs",
    ),
    "one chart": (
        "radiant_viewer.charts.change_of_known_chart",
        "radiant_viewer.charts.frame_chart",
        "radiant_viewer.charts.slack_chart",
    ),
    "one layer, in plain numbers": (
        "radiant_viewer.layers.forecast_layer",
        "radiant_viewer.layers.load_layer",
        "radiant_viewer.layers.support_layer",
    ),
    "figures of a run without a window": (
        "radiant_viewer.runs.ground_map",
        "radiant_viewer.runs.photo_reasons",
        "radiant_viewer.runs.quick_measure",
        "radiant_viewer.runs.replan_picture",
        "radiant_viewer.runs.stored_photographs",
    ),
    "who paints the view, and one of those who can": ("radiant_viewer.splats.open3d_rgbd", "radiant_viewer.splats.painter_choice"),
    "one dock, tool, mark or state of the window": (
        "radiant_viewer.docks.gantt_dock",
        "radiant_viewer.docks.loss_curve",
        "radiant_viewer.docks.ortho_job",
        "radiant_viewer.host.marks",
        "radiant_viewer.host.place_tool",
        "radiant_viewer.host.scale_bar",
        "radiant_viewer.open3d_window.picture",
        "radiant_viewer.pictures.fly_through",
        "radiant_viewer.web.style",
        "radiant_viewer.window.place_label",
        "radiant_viewer.window.shortcuts",
        "radiant_viewer.window.waiting_window",
        "radiant_viewer.window.window_state",
    ),
}


def short_modules_with_one_importer() -> set[str]:
    """Of the installed packages; benchmarks import like others, and are no part of them."""
    files = {module: file for package in PACKAGES for module, file in modules_of(package).items()}
    importers: dict[str, set[str]] = {}
    for module, imported in imports_within(files).items():
        for name in imported:
            importers.setdefault(name, set()).add(module)
    return {
        module
        for module, file in files.items()
        if file.stem not in ("__init__", "__main__") and not module.startswith("benchmarks.")
        if len(importers.get(module, ())) == 1 and len(file.read_text().splitlines()) < SHORT
    }


def test_a_short_module_with_one_importer_stands_for_an_idea() -> None:
    short, named = short_modules_with_one_importer(), {module for modules in IDEAS.values() for module in modules}
    assert sorted(short - named) == [], "join these to their importers, or say above which idea they stand for"
    assert sorted(named - short) == [], "these are longer, gone, or have more importers: leave them out above"


def test_each_is_named_once() -> None:
    modules = [module for of_idea in IDEAS.values() for module in of_idea]
    assert len(modules) == len(set(modules))
