// One page per scene. The splats are drawn by SuperSplat Viewer; lines, places and pictures by this file.
// Coordinates in scene.json are those of the viewer: metres east, up, south.
import { createViewer } from './supersplat-viewer.js';

const byId = (id) => document.getElementById(id);
const scene = JSON.parse(byId('scene-data').textContent) ?? (await (await fetch('./scene.json')).json());
const options = new URL(location.href).searchParams;
// The 3D view of the inspector's page, which has controls of its own.
const frame = window.frameElement;

const viewer = await createViewer({
  container: byId('scene'),
  settings: scene.settings,
  contentUrl: scene.content,
  contentFilename: scene.contentName,
  aa: scene.antialiased,
  renderer: options.has('webgl') ? 'webgl' : 'webgpu',
  fullload: options.has('fullload'),
  noanim: true,
  ui: !frame
}).catch((error) => {
  byId('about').textContent = `This browser cannot draw the model: ${error.message}.`;
  return new Promise(() => {});
});
window.radiantViewer = viewer;
// The model's z is up, the viewer's is y.
const turn = (entity) => { if (entity.name === 'gsplat') entity.setLocalEulerAngles(-90, 0, 0); };
viewer.app.root.children.forEach(turn);
viewer.app.root.on('childinsert', turn);

// ---- lines over the model -------------------------------------------------------------------
const canvas = byId('lines');
const pen = canvas.getContext('2d');
const shown = new Set(scene.layers.filter((layer) => layer.shown).map((layer) => layer.name));
let marks = [];
const repaint = () => { viewer.app.renderNextFrame = true; draw(); };

// Ends of a segment in clip coordinates, cut at the near plane; null behind it.
const NEAR = 1e-3;
const cut = (a, b) => {
  if (a[3] < NEAR && b[3] < NEAR) return null;
  const share = (NEAR - a[3]) / (b[3] - a[3]);
  const between = () => a.map((value, axis) => value + share * (b[axis] - value));
  return [a[3] < NEAR ? between() : a, b[3] < NEAR ? between() : b];
};

function draw() {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const camera = viewer.app.root.findByName('camera')?.camera;
  if (!camera || !viewer.state.loaded) return;
  const v = camera.viewMatrix.data, p = camera.projectionMatrix.data;
  const times = (m, q) => [0, 1, 2, 3].map((row) => m[row] * q[0] + m[row + 4] * q[1] + m[row + 8] * q[2] + m[row + 12] * q[3]);
  const clip = (point) => times(p, times(v, [point[0], point[1], point[2], 1]));
  const screen = (q) => [(q[0] / q[3] + 1) / 2 * width, (1 - q[1] / q[3]) / 2 * height];
  for (const layer of [...scene.layers, { lines: marks, labels: [] }]) {
    if (layer.name && !shown.has(layer.name)) continue;
    for (const line of layer.lines) {
      pen.strokeStyle = line.color;
      pen.lineWidth = line.width;
      pen.beginPath();
      const corners = line.points.map(clip);
      for (let i = 0; i + 1 < corners.length; i++) {
        const segment = cut(corners[i], corners[i + 1]);
        if (!segment) continue;
        pen.moveTo(...screen(segment[0]));
        pen.lineTo(...screen(segment[1]));
      }
      pen.stroke();
    }
    pen.font = '600 13px system-ui, sans-serif';
    pen.textAlign = 'center';
    for (const label of layer.labels) {
      const q = clip(label.at);
      if (q[3] < NEAR) continue;
      pen.lineWidth = 4;
      pen.strokeStyle = 'rgb(20 22 26 / 80%)';
      pen.strokeText(label.text, ...screen(q));
      pen.fillStyle = '#fff';
      pen.fillText(label.text, ...screen(q));
    }
  }
}
viewer.app.on('frameend', draw);
new ResizeObserver(repaint).observe(canvas);
viewer.events.on('loaded:changed', () => {
  viewer.state.cameraMode = 'orbit';
  repaint();
});

// ---- the panel ------------------------------------------------------------------------------
const add = (parent, tag, content = {}) => Object.assign(parent.appendChild(document.createElement(tag)), content);
byId('about').textContent = scene.about;

for (const layer of scene.layers) {
  byId('layers').hidden = false;
  const label = add(byId('layers'), 'label');
  const box = add(label, 'input', { type: 'checkbox', checked: layer.shown });
  add(label, 'span', { className: 'swatch' }).style.background = layer.color;
  add(label, 'span', { textContent: layer.name });
  box.addEventListener('change', () => {
    box.checked ? shown.add(layer.name) : shown.delete(layer.name);
    repaint();
  });
}

const listed = (section, title, text, act) => {
  byId(section).hidden = false;
  const button = add(byId(section), 'button', { type: 'button' });
  const words = add(button, 'span', { textContent: title });
  if (text) add(words, 'small', { textContent: text });
  button.addEventListener('click', act);
};
scene.settings.annotations.forEach((place, index) => {
  listed('bookmarks', place.title, place.text, () => { if (viewer.state.loaded) viewer.selectAnnotation(index); });
});

const wipe = byId('wipe');
const wiped = () => { byId('render').style.clipPath = `inset(0 0 0 ${wipe.value}%)`; };
wipe.addEventListener('input', wiped);
for (const pair of scene.comparisons) {
  listed('comparisons', pair.title, pair.text, () => {
    byId('photograph').src = pair.photograph;
    byId('render').src = pair.render;
    byId('compare').querySelector('figcaption').textContent = `${pair.title}: photograph | model`;
    byId('compare').hidden = false;
    wiped();
    wipe.focus();
  });
}
byId('close-compare').addEventListener('click', () => { byId('compare').hidden = true; });

const panel = byId('panel'), open = byId('open');
const narrow = window.matchMedia('(max-width: 600px)');
const fold = (hidden) => {
  panel.hidden = hidden;
  open.setAttribute('aria-expanded', String(!hidden));
  open.textContent = hidden ? 'Layers' : 'Close';
};
open.addEventListener('click', () => fold(!panel.hidden));
const arrange = () => fold(narrow.matches);
narrow.addEventListener('change', arrange);
arrange();

// ---- inside the inspector's page: it says where to look and what to show --------------------
if (frame) {
  document.body.className = 'framed';
  let looked = 0;
  const obey = () => {
    const told = JSON.parse(frame.dataset.told || 'null');
    if (!told || !viewer.state.loaded) return;
    shown.clear();
    told.layers.forEach((name) => shown.add(name));
    marks = told.mark ? [told.mark] : [];
    if (told.look && told.look.number !== looked) {
      looked = told.look.number;
      // The viewer flies to annotations only; this one is gone before it is drawn.
      const place = { title: '', text: '', extras: {}, position: told.look.target, camera: { initial: told.look } };
      viewer.selectAnnotation(viewer.annotations.push(place) - 1);
      viewer.annotations.pop();
      viewer.selectAnnotation(null);
    }
    repaint();
  };
  new MutationObserver(obey).observe(frame, { attributes: true, attributeFilter: ['data-told'] });
  const ready = () => { if (viewer.state.loaded) { frame.dataset.loaded = ''; obey(); } };
  viewer.events.on('loaded:changed', ready);
  ready();
}
