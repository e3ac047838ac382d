"""The cleaning of the model: its steps with what each leaves out, and the rules for a further one.
Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QDockWidget,
    QDoubleSpinBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QListWidget,
    QPushButton,
    QScrollArea,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import (
    CleaningStep,
    OpacityStep,
    PolygonStep,
    RegionsStep,
    SizeStep,
    SupportStep,
    describe,
)
from radiant_core.geometry.support import MIN_PARALLAX_DEG, MIN_VIEWS
from radiant_viewer.docks.box_editor import BoxEditor
from radiant_viewer.docks.pages_job import PagesJob
from radiant_viewer.docks.select_row import SelectRow
from radiant_viewer.host.polygon_tool import PolygonTool
from radiant_viewer.host.protocols import Host
from radiant_viewer.pictures.turntable import haze_size
from radiant_viewer.runs.cleaning_session import CleaningSession

MARK, HINT = "Polygon", "Cleaning: click the corners of a polygon on the map, then keep or leave out its inside; Backspace takes one back."
USUAL_OPACITY, USUAL_MARGIN = 0.05, 10.0
LEAVE_OUT, FIELD_PX = "Leave out rest", 104
WITHOUT_SUPPORT = "Not measured for this model: run 'radiant clean RUN --measure' in a terminal"


class CleaningDock(QDockWidget):
    """`session` holds the model's cleaning, None without a model: then only the box is there."""

    def __init__(self, host: Host, session: CleaningSession | None, unit: str, ground: float, pages: PagesJob) -> None:
        super().__init__("Cleaning")
        self.pages = pages
        self.setObjectName("cleaning")
        self._host, self.session, self._unit = host, session, unit
        self.box = BoxEditor(host, session, unit)
        self.polygon = PolygonTool(host, unit, ground, mark=MARK, hint=HINT)
        self.steps = QListWidget()
        self.steps.setToolTip("What is left out of the model, in this order; of every export, film, picture and surface")
        self.count, self.draw = QLabel(""), QPushButton("Draw on map")
        self.count.setProperty("soft", "true")
        self.draw.setCheckable(True)
        self.draw.setToolTip(HINT)
        self.draw.toggled.connect(self.polygon.set_active)
        self.undo, self.redo, self.reset = QPushButton("Undo"), QPushButton("Redo"), QPushButton("Reset")
        self.select = None if session is None else SelectRow(host, session, self._add)
        self.margin = _spin(0, 1e6, USUAL_MARGIN, f" {unit}")
        self.views, self.parallax = QSpinBox(), _spin(0, 180, MIN_PARALLAX_DEG, "° apart")
        self.views.setRange(1, 1000)
        self.views.setValue(MIN_VIEWS)
        self.views.setSuffix(" photos")
        self.opacity = _spin(0.001, 0.999, USUAL_OPACITY, "", 3)
        self.width_limit = _spin(1e-4, 1e6, 1.0 if session is None else haze_size(session.model.whole), f" {unit}", 3)
        self.keep_region, self.keep_support = QPushButton(LEAVE_OUT), QPushButton(LEAVE_OUT)
        self.keep_opacity, self.keep_size = QPushButton(LEAVE_OUT), QPushButton(LEAVE_OUT)
        self._connect()
        self._lay_out()
        self.show_session()

    def show_session(self) -> None:
        """Show the steps as they are now."""
        self.steps.clear()
        if self.session is None:
            return
        model = self.session.model
        for step, removed in zip(model.cleaning.steps, model.cleaned.removed, strict=True):
            self.steps.addItem(f"−{removed:,}   kept: {describe(step, self._unit)}")
        for step in reversed(model.cleaning.undone):
            self.steps.addItem(f"(taken back)   {describe(step, self._unit)}")
            self.steps.item(self.steps.count() - 1).setForeground(self.palette().placeholderText())
        self.undo.setEnabled(bool(model.cleaning.steps))
        self.reset.setEnabled(bool(model.cleaning.steps))
        self.redo.setEnabled(bool(model.cleaning.undone))
        self.count.setText(self._total_text())
        self.box.show_count()
        if self.select is not None:
            self.select.show_chosen()
        self.pages.look()

    def keep_inside(self, keep: Literal["inside", "outside"]) -> None:
        """Make a step of the drawn polygon; BadInput before it has three corners."""
        corners = self.polygon.corners
        if len(corners) < 3:
            raise BadInput("no polygon is drawn: press 'Draw on map' and click three corners or more on the map.")
        step = PolygonStep(corners=tuple((float(x), float(y)) for x, y in corners), keep=keep)
        # It clears the status bar.
        self.draw.setChecked(False)
        self._add(step)

    @property
    def is_in_front(self) -> bool:
        """Whether the panel is seen, not behind another's tab."""
        return self.isVisible() and not self.visibleRegion().isEmpty()

    def undo_last(self) -> None:
        """Take the last stroke of lasso or brush back, or else the last step."""
        if self.select is not None and self.select.tool.strokes:
            self.select.tool.undo()
        else:
            self.undo.click()

    def redo_last(self) -> None:
        """Make the stroke that was taken back again, or else the step."""
        if self.select is not None and self.select.tool.has_undone:
            self.select.tool.redo()
        else:
            self.redo.click()

    def _add(self, step: CleaningStep) -> None:
        assert self.session is not None
        self.session.add(step)
        older = self.pages.look()
        advice = f"{older}: Rewrite pages" if older else "Exports, films, pictures and surfaces follow; F5 measures seams anew"
        self._host.show_status(f"{self._total_text()}. {advice}.")

    def _total_text(self) -> str:
        assert self.session is not None
        model = self.session.model
        return f"{model.cleaned.num_left_out:,} of {len(model.whole):,} Gaussians left out"

    def _preview(self, step: Callable[[], CleaningStep]) -> None:
        """Say what a rule would leave out, while its figures are turned."""
        assert self.session is not None
        try:
            self.count.setText(f"{self.session.count(step()):,} more would be left out")
        except BadInput as error:
            self.count.setText(str(error))

    def _connect(self) -> None:
        if self.session is None:
            return
        session = self.session
        rules: list[tuple[QPushButton, Callable[[], CleaningStep], Sequence[QSpinBox | QDoubleSpinBox]]] = [
            (self.keep_region, lambda: RegionsStep(margin=self.margin.value()), (self.margin,)),
            (
                self.keep_support,
                lambda: SupportStep(num_views=self.views.value(), parallax_deg=self.parallax.value()),
                (self.views, self.parallax),
            ),
            (self.keep_opacity, lambda: OpacityStep(at_least=self.opacity.value()), (self.opacity,)),
            (self.keep_size, lambda: SizeStep(at_most=self.width_limit.value()), (self.width_limit,)),
        ]
        for button, step, fields in rules:
            button.clicked.connect(partial(self._attempt_step, step))
            for field in fields:
                field.valueChanged.connect(partial(self._on_turned, step))
        for button, change in ((self.undo, session.undo), (self.redo, session.redo), (self.reset, session.reset)):
            button.clicked.connect(partial(self._attempt, change))

    def _on_turned(self, step: Callable[[], CleaningStep], _: float) -> None:
        self._preview(step)

    def _attempt(self, change: Callable[[], None], _: bool = False) -> None:
        self._host.attempt(change)

    def _attempt_step(self, step: Callable[[], CleaningStep], _: bool = False) -> None:
        self._host.attempt(lambda: self._add(step()))

    def _lay_out(self) -> None:
        column, rules = QVBoxLayout(), QGridLayout()
        buttons = QHBoxLayout()
        for button in (self.undo, self.redo, self.reset, self.pages.button):
            buttons.addWidget(button)
        buttons.addWidget(self.count, stretch=1)
        column.addWidget(self.steps, stretch=1)
        if self.select is not None:
            column.addWidget(self.select)
        column.addLayout(buttons)
        inside, outside = QPushButton("Keep inside"), QPushButton("Leave it out")
        inside.clicked.connect(lambda: self._host.attempt(lambda: self.keep_inside("inside")))
        outside.clicked.connect(lambda: self._host.attempt(lambda: self.keep_inside("outside")))
        rows: tuple[tuple[str, QWidget, QWidget | None, QWidget], ...] = (
            ("Polygon", self.draw, outside, inside),
            ("Regions and", self.margin, None, self.keep_region),
            ("Seen by", self.views, self.parallax, self.keep_support),
            ("Opacity from", self.opacity, None, self.keep_opacity),
            ("At most wide", self.width_limit, None, self.keep_size),
        )
        for row, (name, first, second, button) in enumerate(rows):
            rules.addWidget(QLabel(name), row, 0)
            rules.addWidget(first, row, 1)
            first.setMaximumWidth(FIELD_PX)
            if second is not None:
                rules.addWidget(second, row, 2)
                second.setMaximumWidth(FIELD_PX)
            rules.addWidget(button, row, 3)
        rules.setRowStretch(len(rows), 1)
        self.keep_support.setToolTip("What fewer photographs show, or from nearly one direction, may hang at any depth")
        self.keep_size.setToolTip("Wider ones are haze and floaters: the longest standard deviation counts")
        body = QWidget()
        across = QHBoxLayout(body)
        across.setContentsMargins(4, 2, 4, 2)
        across.addLayout(column, stretch=1)
        across.addLayout(rules)
        across.addWidget(self.box)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setFrameShape(QScrollArea.Shape.NoFrame)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAsNeeded)
        area.setWidget(body)
        self.setWidget(area)
        for widget in (*(row[1] for row in rows), inside, outside, *(row[3] for row in rows), self.undo, self.redo, self.reset):
            widget.setEnabled(self.session is not None)
        self._disable_what_is_not_known()

    def _disable_what_is_not_known(self) -> None:
        """A model alone has no regions and no photographs, and not every run measured support."""
        if self.session is None:
            return
        for step, widgets, why in (
            (RegionsStep(), (self.margin, self.keep_region), "This model was made without a plan"),
            (SupportStep(), (self.views, self.parallax, self.keep_support), WITHOUT_SUPPORT),
        ):
            try:
                self.session.count(step)
            except BadInput:
                for widget in widgets:
                    widget.setEnabled(False)
                    widget.setToolTip(why)


def _spin(low: float, high: float, value: float, suffix: str, decimals: int = 1) -> QDoubleSpinBox:
    field = QDoubleSpinBox()
    field.setDecimals(decimals)
    field.setRange(low, high)
    field.setSuffix(suffix)
    field.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
    field.setValue(float(np.clip(value, low, high)))
    return field
