"""The style of the page for a browser, and the width below which it is laid out for a phone."""

from __future__ import annotations

NARROW_PX = 700
"""Below this width of the window; `STYLE` says so too."""
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
.rad-views { flex: 1 1 0; min-height: 0; display: flex; }
.rad-whole { height: calc(100dvh - 45px); display: flex; flex-direction: column; }
.rad-lower { height: var(--rad-lower); border-top: 1px solid rgba(128,128,128,.35); display: flex; }
.rad-pane iframe { position: absolute; inset: 0; width: 100%; height: 100%; border: 0; z-index: 1; visibility: hidden; }
/* The frame says so itself, once it has drawn. */
.rad-pane iframe[data-loaded] { visibility: visible; }
.rad-pane .rad-drawn { position: absolute; right: 8px; top: 5px; z-index: 2; }
.rad-pane .v-btn.rad-drawn { border: 1px solid rgba(128,128,128,.55); }
.rad-tab { flex: 1 1 0; min-height: 0; overflow: auto; }
.rad-table table { font-size: 12.5px; }
.rad-table th, .rad-table tr[data-camera] td,
.rad-table tr[data-seam] td { height: 28px !important; padding: 0 10px !important; white-space: nowrap; }
.rad-table td { font-variant-numeric: tabular-nums; cursor: pointer; }
.rad-table tr.chosen td { background: rgba(var(--v-theme-primary), .22); }
.rad-table tbody tr:hover td { background: rgba(var(--v-theme-primary), .10); }
.rad-panel { flex: none; width: var(--rad-panel); border-left: 1px solid rgba(128,128,128,.35); display: flex; flex-direction: column; }
.rad-photo { position: relative; flex: 1 1 0; min-height: 0; display: flex; align-items: center; justify-content: center; }
.rad-photo img { position: absolute; left: 0; top: 0; width: 100%; height: 100%; object-fit: contain; }
.rad-slider { position: absolute; left: 6px; right: 6px; bottom: 4px; margin: 0 !important; border-radius: 12px;
  background: rgba(var(--v-theme-surface), .72); }
.rad-chart { max-width: 100%; background: white; }
/* Drawn on white once per run: turned dark, its hues stay. */
.v-theme--dark .rad-chart { filter: invert(.89) hue-rotate(180deg); }
.rad-soft { font-size: 12px; opacity: .75; }
.rad-figure { font-size: 11px; line-height: 16px; white-space: nowrap; }
.rad-figure b { font-variant-numeric: tabular-nums; }
/* A phone: views above each other, layers and the chosen photograph as sheets from below, larger targets. */
@media (max-width: 699px) {
  :root { --rad-lower: 34dvh; }
  .rad-bar .v-toolbar__content > .ml-4 { margin-left: 8px !important; overflow: hidden; text-overflow: ellipsis; }
  .rad-bar .v-btn-toggle .v-btn { padding: 0 9px; min-width: 0; }
  .rad-subtitle { display: none; }
  .rad-views { flex-direction: column; }
  .rad-pane.rad-second { border-left: none; border-top: 1px solid rgba(128,128,128,.35); }
  .rad-panel { position: fixed; left: 0; right: 0; bottom: 0; z-index: 1010; width: auto; height: 62dvh; border-left: none;
    border-radius: 14px 14px 0 0; background: rgb(var(--v-theme-background)); box-shadow: 0 -2px 16px rgba(0,0,0,.35); }
  .rad-panel.rad-empty { display: none; }
  .rad-layer { min-height: 44px; padding: 0 10px; }
  .rad-layer .v-btn { min-height: 36px; min-width: 56px; }
  .v-tab.v-btn { padding: 0 9px; min-width: 0; letter-spacing: normal; font-size: 13px; }
  .rad-tab img { max-width: none !important; width: 720px; }
  .v-navigation-drawer--bottom { border-radius: 14px 14px 0 0; }
}
"""

assert f"max-width: {NARROW_PX - 1}px" in STYLE
