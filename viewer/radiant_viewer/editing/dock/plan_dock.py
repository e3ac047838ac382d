"""The dock in which a plan is changed through `PlanActions`. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from html import escape

from PySide6.QtCore import QEvent, QObject, QSignalBlocker, QSize, Qt
from PySide6.QtWidgets import (
    QComboBox,
    QDockWidget,
    QDoubleSpinBox,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLayout,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from radiant_core.plan.plans import CloudPlan
from radiant_viewer.editing.model.edited_plan import EditedPlan
from radiant_viewer.editing.model.plan_edits import FreeRegion, LockRegion, ReleaseAll, RemoveEdge
from radiant_viewer.editing.model.plan_report import ComparedRow, certificate_text, headline
from radiant_viewer.editing.tools.plan_actions import PlanActions
from radiant_viewer.runs.words import tip as meanings

FILTER_TIP = """Conditions joined by "and": psnr < 22 and region = north
Figures: {figures}
= and != take names, ~ a part of one; a lone word is looked for in names"""


MAX_COMPARED = 12
"""Rows of two plans' figures."""
HEADLINE_PX = 14
"""Extra width beside the buttons, so that the headline fits on one line."""


class PlanDock(QDockWidget):
    """`region` and `device` are chosen here or in the table of loads; buttons call `actions`."""

    def __init__(self, actions: PlanActions) -> None:
        super().__init__("Plan")
        self.setObjectName("plan")
        self._actions = actions
        self.headline, self.certificate, self.changes = _label(strong=True), _label(), _label()
        self.working = QProgressBar()
        self.working.setRange(0, 0)
        self.working.setMaximumHeight(4)
        self.working.setTextVisible(False)
        keeps = self.working.sizePolicy()
        # It keeps its place when hidden, so that nothing moves while a plan is solved.
        keeps.setRetainSizeWhenHidden(True)
        self.working.setSizePolicy(keeps)
        self.working.hide()
        self.filter, self.selected = QLineEdit(), _label(soft=True)
        self.filter.setPlaceholderText("psnr < 22 and region = …")
        self.filter.setToolTip(FILTER_TIP.format(figures=", ".join(actions.figures.columns)))
        self.filter.returnPressed.connect(lambda: actions.select_filtered(self.filter.text()))
        self.region, self.target = QComboBox(), QComboBox()
        self.region.setToolTip("The region and edge that the buttons below are for; a row of the table chooses it, too")
        self.region.currentTextChanged.connect(lambda _: self._update_buttons())
        self.device: str | None = None
        self.slack = QDoubleSpinBox()
        self.slack.setRange(1.0, 3.0)
        self.slack.setSingleStep(0.05)
        self.slack.setDecimals(2)
        self.slack.setToolTip(meanings("slack", "makespan", "bound"))
        self.headline.setToolTip(meanings("makespan", "bound"))
        self.certificate.setToolTip(meanings("certificate", "region"))
        self.changes.setToolTip(meanings("change hands", "makespan", "bound"))
        self.buttons: dict[str, QPushButton] = {}
        body, tools = QWidget(), QWidget()
        layout, inner = QVBoxLayout(body), QVBoxLayout(tools)
        layout.setContentsMargins(4, 4, 4, 4)
        inner.setContentsMargins(0, 0, 0, 0)
        inner.setSpacing(4)
        self._add_cameras(inner)
        self._add_regions(inner)
        self._add_files(inner)
        inner.addStretch(1)
        area = _area(tools)
        area.setMinimumWidth(tools.minimumSizeHint().width() + area.verticalScrollBar().sizeHint().width() + HEADLINE_PX)
        for widget in (self.working, self._conflict(), self.headline):
            layout.addWidget(widget)
        layout.addLayout(self._history_row())
        layout.addWidget(area, stretch=1)
        # Below the scrolled buttons: always visible, and a longer text does not move the buttons.
        layout.addWidget(_Results(self.changes, self.certificate))
        self.setWidget(body)

    def choose(self, edge: str, device: str | None) -> None:
        """Choose the edge, and its device if given, that the buttons act on."""
        self.device = device
        self.region.setCurrentText(edge)
        self._update_buttons()

    def show_plan(self, plan: EditedPlan, changes: str) -> None:
        """Show the figures of a plan and what it changed."""
        self.show_figures(plan.cloud, changes)
        ids = [edge.id for edge in plan.wishes.system.edges]
        for box in (self.region, self.target):
            with QSignalBlocker(box):
                if [box.itemText(index) for index in range(box.count())] != ids:
                    chosen = box.currentText()
                    box.clear()
                    box.addItems(ids)
                    box.setCurrentText(chosen)
        if self.device not in [device.id for device in plan.wishes.system.devices]:
            self.device = None
        with QSignalBlocker(self.slack):
            self.slack.setValue(plan.wishes.slack or 1.0)
        self._update_buttons()

    def show_conflict(self, sentence: str) -> None:
        """Show sentence and buttons of a conflict with another window; an empty one hides them."""
        self.conflict_text.setText(sentence)
        self.conflict.setVisible(bool(sentence))

    def show_figures(self, cloud: CloudPlan, changes: str) -> None:
        """Show headline, certificate and changes only, as during a drag."""
        self.headline.setText(headline(cloud))
        self.certificate.setText(certificate_text(cloud))
        self.changes.setText(changes)

    def show_comparison(self, file_name: str, text: str, rows: Sequence[ComparedRow]) -> None:
        """Show the difference from another plan, with up to `MAX_COMPARED` figures of both."""
        self.changes.setText(_comparison_html(file_name, text, rows))

    def show_selected(self, count: int, target: str | None = None) -> None:
        """Show how many cameras are selected; `target` is the suggested edge to pin them to."""
        self.selected.setText(f"{count} selected" if count else "Shift and drag on the map selects")
        if target is not None:
            self.target.setCurrentText(target)
        self._update_buttons()

    def show_reason(self, reason: str) -> None:
        """Show why the plan cannot be changed, and disable what would change it."""
        self.changes.setText(reason)
        for name, button in self.buttons.items():
            button.setEnabled(name in ("Compare…", "Regions to GIS…"))
        for widget in (self.filter, self.region, self.target, self.slack):
            widget.setEnabled(False)

    def _update_buttons(self) -> None:
        session = self._actions.session
        if session is None:
            return
        editor, constraints = session.editor, session.editor.state.wishes.constraints
        edge = self.region.currentText()
        is_held = edge in constraints.locked or edge in constraints.fixed_weights_m2
        has_selection = bool(self._actions.selected)
        device = self.device or "the last device"
        for name, enabled, tip in (
            ("Undo", bool(editor.undo_text), f"Undo: {editor.undo_text or 'nothing'} (Ctrl+Z)"),
            ("Redo", bool(editor.redo_text), f"Redo: {editor.redo_text or 'nothing'} (Ctrl+Shift+Z)"),
            ("Pin to", has_selection, "The selected cameras belong to this edge, whatever the planner thinks"),
            ("Unpin", has_selection and bool(constraints.pinned), "Take the pins of the selected cameras out"),
            ("Lock", edge not in constraints.locked, f"{edge} keeps the cameras it has, and gets no others"),
            ("Free", is_held, f"Take lock and dragged borders of {edge} back"),
            ("− Edge", len(editor.state.wishes.system.edges) > 1, f"Remove {edge} and its devices"),
            ("+ Device", True, f"A device more at {edge}, like {device}"),
            ("− Device", self.device is not None, f"Remove {self.device or 'the device that is chosen in the table'}"),
            ("Free all", bool(constraints) or editor.state.wishes.slack is not None, "Nothing locked, dragged, pinned or slack"),
        ):
            self.buttons[name].setEnabled(enabled)
            self.buttons[name].setToolTip(tip)

    def _conflict(self) -> QWidget:
        self.conflict, self.conflict_text = QFrame(), _label()
        self.conflict.setFrameShape(QFrame.Shape.StyledPanel)
        layout, row = QVBoxLayout(self.conflict), QHBoxLayout()
        layout.setContentsMargins(6, 4, 6, 4)
        for name, take_over, tip in (
            ("Keep mine", True, "This window's edits count; those of the other window are kept in a file beside"),
            ("Take theirs", False, "Show the plan as the other window has it; this window's edits are kept in a file beside"),
        ):
            row.addWidget(self._button(name, partial(self._actions.resolve_conflict, take_over=take_over)))
            self.buttons[name].setToolTip(tip)
        layout.addWidget(self.conflict_text)
        layout.addLayout(row)
        self.conflict.hide()
        return self.conflict

    def _history_row(self) -> QLayout:
        row = QHBoxLayout()
        for name, action in (("Undo", self._actions.undo), ("Redo", self._actions.redo)):
            row.addWidget(self._button(name, action))
        row.addWidget(self._button("Free all", lambda: self._actions.do(ReleaseAll())), stretch=1)
        return row

    def _add_cameras(self, layout: QVBoxLayout) -> None:
        layout.addWidget(_heading("Cameras"))
        grid = QGridLayout()
        grid.setSpacing(4)
        grid.addWidget(self.filter, 0, 0, 1, 3)
        grid.addWidget(self._button("Select", lambda: self._actions.select_filtered(self.filter.text())), 0, 3)
        self.buttons["Select"].setToolTip("Select the cameras that meet the conditions (Return)")
        grid.addWidget(self.selected, 1, 0, 1, 3)
        grid.addWidget(self._button("None", lambda: self._actions.select(())), 1, 3)
        self.buttons["None"].setToolTip("Select no camera")
        grid.addWidget(self._button("Pin to", lambda: self._actions.pin(self.target.currentText())), 2, 0)
        grid.addWidget(self.target, 2, 1, 1, 2)
        grid.addWidget(self._button("Unpin", lambda: self._actions.pin(None)), 2, 3)
        grid.setColumnStretch(1, 1)
        layout.addLayout(grid)

    def _add_regions(self, layout: QVBoxLayout) -> None:
        layout.addWidget(_heading("Regions and machines"))
        grid = QGridLayout()
        grid.setSpacing(4)
        grid.addWidget(self.region, 0, 0, 1, 3)
        actions = self._actions
        places: list[tuple[str, Callable[[], object], int, int]] = [
            ("Lock", lambda: actions.do(LockRegion(edge=self.region.currentText())), 1, 0),
            ("Free", lambda: actions.do(FreeRegion(edge=self.region.currentText())), 2, 0),
            ("+ Edge", lambda: actions.add_edge(self.region.currentText()), 1, 1),
            ("− Edge", lambda: actions.do(RemoveEdge(edge=self.region.currentText())), 2, 1),
            ("+ Device", lambda: actions.add_device(self.region.currentText(), self.device), 1, 2),
            ("− Device", lambda: actions.remove_device(self.device), 2, 2),
        ]
        for name, action, row, column in places:
            grid.addWidget(self._button(name, action), row, column)
        self.buttons["+ Edge"].setToolTip(
            "A new edge in the middle of the map, with devices like those of the chosen one; drag it afterwards"
        )
        layout.addLayout(grid)
        row = QHBoxLayout()
        row.addWidget(QLabel("Slack ×"))
        row.addWidget(self.slack, stretch=1)
        row.addWidget(self._button("Apply", lambda: actions.set_slack(self.slack.value())))
        self.buttons["Apply"].setToolTip("Plan with this slack; 1 means as fast as possible, without slack")
        layout.addLayout(row)

    def _add_files(self, layout: QVBoxLayout) -> None:
        layout.addWidget(_heading("Plans"))
        row = QHBoxLayout()
        for name, action, tip in (
            ("Save…", self._actions.ask_save, "Save the plan, its system and its constraints, for radiant run --plan (Ctrl+Shift+P)"),
            ("Load…", self._actions.ask_load, "Put a plan of the same cameras and machines in the place of this one"),
            ("Compare…", self._actions.ask_compare, "Show which cameras are elsewhere in another plan"),
        ):
            row.addWidget(self._button(name, action))
            self.buttons[name].setToolTip(tip)
        layout.addLayout(row)
        layout.addWidget(self._button("Regions to GIS…", self._actions.ask_regions))
        self.buttons["Regions to GIS…"].setToolTip("The regions, strips and cameras of this plan as GeoJSON, as QGIS opens it (Ctrl+G)")

    def _button(self, name: str, action: Callable[[], object]) -> QPushButton:
        button = self.buttons[name] = QPushButton(name)
        button.clicked.connect(lambda _: action())
        return button


def _comparison_html(file_name: str, text: str, rows: Sequence[ComparedRow]) -> str:
    head = f"<tr><th></th><th align='left'>this plan</th><th align='left'>{escape(file_name)}</th></tr>"
    cells = [
        f"<tr><td>{escape(row.name)}&nbsp;&nbsp;</td><td>{escape(row.value)}&nbsp;&nbsp;</td><td>{escape(row.compared)}</td></tr>"
        for row in rows[:MAX_COMPARED]
    ]
    left_out = len(rows) - len(cells)
    more = f"<p>… and {left_out} more edges</p>" if left_out else ""
    return f"<p>Against {escape(file_name)}: {escape(text)}</p><table>{head}{''.join(cells)}</table>{more}"


class _Results(QScrollArea):
    """Stacked texts at their own height, up to half of the panel, scrolled beyond."""

    def __init__(self, *labels: QLabel) -> None:
        super().__init__()
        self._body = QWidget()
        layout = QVBoxLayout(self._body)
        layout.setContentsMargins(0, 4, 0, 0)
        for label in labels:
            layout.addWidget(label)
        layout.addStretch(1)
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setWidget(self._body)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)
        self._body.installEventFilter(self)

    def sizeHint(self) -> QSize:
        panel = self.parentWidget()
        room = 0 if panel is None else panel.height() // 2
        layout = self._body.layout()
        assert layout is not None
        # The width is the panel's.
        return QSize(0, min(room, layout.heightForWidth(self.viewport().width())))

    def minimumSizeHint(self) -> QSize:
        """The same: a smaller one would let the tools above squeeze the texts."""
        return self.sizeHint()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Follow texts that become longer or shorter."""
        if watched is self._body and event.type() in (QEvent.Type.LayoutRequest, QEvent.Type.Resize):
            self.updateGeometry()
        return super().eventFilter(watched, event)


def _area(body: QWidget) -> QScrollArea:
    area = QScrollArea()
    area.setWidgetResizable(True)
    area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    area.setWidget(body)
    return area


def _label(*, strong: bool = False, soft: bool = False) -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    if strong:
        label.setStyleSheet("font-weight: 600")
    if soft:
        label.setProperty("soft", "true")
    return label


def _heading(text: str) -> QWidget:
    frame = QFrame()
    layout = QVBoxLayout(frame)
    layout.setContentsMargins(0, 2, 0, 0)
    label = QLabel(text)
    label.setStyleSheet("font-weight: 600")
    layout.addWidget(label)
    return frame
