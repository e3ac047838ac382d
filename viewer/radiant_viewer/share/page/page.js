// One page per scene. The splats are drawn by SuperSplat Viewer; lines, places and pictures by this file.
// Coordinates in scene.json are those of the viewer: metres east, up, south.
import { createViewer } from './supersplat-viewer.js';

const byId = (id) => document.getElementById(id);
const scene = JSON.parse(byId('scene-data').textContent) ?? (await (await fetch('./scene.json')).json());
const options = new URL(location.href).searchParams;
// The 3D view of the inspector's page, which has controls of its own.
const frame = window.frameElement;

// A window that is higher than wide sees less to either side: from so much farther it sees all.
const fitted = (camera) => {
  const share = Math.min(1, window.innerWidth / window.innerHeight);
  return { ...camera, position: camera.position.map((value, axis) => camera.target[axis] + (value - camera.target[axis]) / share) };
};
scene.settings.cameras.forEach((one) => { one.initial = fitted(one.initial); });

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
let marks = [], ruler = [], colors = {};
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
  for (const layer of [...scene.layers, { lines: marks, labels: [] }, rulerLayer()]) {
    if (layer.name && !shown.has(layer.name)) continue;
    const worn = colors[layer.name];
    for (const [place, line] of layer.lines.entries()) {
      pen.strokeStyle = worn ? worn[place % worn.length] : line.color;
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
viewer.app.on('frameend', () => { draw(); drawScale(); });
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
// The viewer flies to annotations only; this one is gone before it is drawn.
const flyTo = (camera) => {
  if (!viewer.state.loaded) return;
  const place = { title: '', text: '', extras: {}, position: camera.target, camera: { initial: camera } };
  viewer.selectAnnotation(viewer.annotations.push(place) - 1);
  viewer.annotations.pop();
  viewer.selectAnnotation(null);
};
const sections = new Map();
for (const place of scene.places) {
  if (!sections.has(place.group)) {
    const id = `places-${sections.size}`;
    add(add(byId('places'), 'section', { id, hidden: true }), 'h2', { textContent: place.group });
    sections.set(place.group, id);
  }
  listed(sections.get(place.group), place.title, place.text, () => {
    if (place.annotation === null) flyTo(fitted(place.camera));
    else if (viewer.state.loaded) viewer.selectAnnotation(place.annotation);
    if (narrow.matches) fold(true);
  });
}

// ---- measuring: two picked points, and a bar of known length on the ground --------------------
// σ of a point: half a pixel of the screen and of the photographs, and how much the surface next to
// it scatters; of a distance: both points, and the share by which the scale is known.
const how = scene.measure;
const camera = () => viewer.app.root.findByName('camera');
const length = (a, b) => Math.hypot(...a.map((value, axis) => value - b[axis]));
const figure = (value, sigma) => {
  const decimals = sigma > 0 ? Math.min(3, Math.max(0, Math.ceil(-Math.log10(sigma)) + (sigma < 1 ? 1 : 0))) : 2;
  const off = sigma > 0 ? ` ± ${sigma.toFixed(decimals)}` : '';
  return `${value.toFixed(decimals)}${off} ${how.unit}`;
};
let picker = null, measuring = false;
viewer.events.on('picker:ready', (ready) => { picker = ready; byId('measure').hidden = false; });

// How much of the scene a pixel of the screen is, at a point of it.
const pixelAt = (point) => {
  const eye = camera().getPosition(), p = camera().camera.projectionMatrix.data;
  return length(point, [eye.x, eye.y, eye.z]) * 2 / p[5] / canvas.clientHeight;
};
async function pickPoint(x, y) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const at = async (dx, dy) => (await picker.pickSurface((x + dx) / width, (y + dy) / height))?.position ?? null;
  const middle = await at(0, 0);
  if (!middle) return null;
  const point = [middle.x, middle.y, middle.z];
  let scatter = 0, count = 0;
  for (const [dx, dy] of [[3, 0], [0, 3]]) {
    const [one, other] = [await at(dx, dy), await at(-dx, -dy)];
    if (!one || !other) continue;
    // Of a plane the middle is half way between its neighbours; (a + b) / 2 − c has 1.5 σ².
    const half = [(one.x + other.x) / 2, (one.y + other.y) / 2, (one.z + other.z) / 2];
    scatter += length(half, point) ** 2 / 1.5;
    count += 1;
  }
  const variance = (count ? scatter / count : 0) + (pixelAt(point) / 2) ** 2 + how.placeSigma ** 2;
  return { point, variance };
}

const rulerLayer = () => {
  const points = ruler.map((one) => one.point);
  if (!points.length) return { lines: [], labels: [] };
  const lines = [{ color: '#14161a', width: 5, points }, { color: '#ffd400', width: 2.5, points }];
  // A point is a cross of three short lines.
  const reach = pixelAt(points[0]) * 9;
  const crosses = points.flatMap((q) => [0, 1, 2].map((axis) => ({
    color: '#ffd400', width: 2, points: [-1, 1].map((way) => q.map((value, other) => value + (other === axis ? way * reach : 0)))
  })));
  const labels = points.length === 2
    ? [{ text: distanceText(), at: points[0].map((value, axis) => (value + points[1][axis]) / 2) }] : [];
  return { lines: [...lines, ...crosses], labels };
};
const sigmaOf = (distance) => Math.sqrt(ruler[0].variance + ruler[1].variance + (distance * how.scaleSigma) ** 2);
const distanceText = () => {
  const distance = length(ruler[0].point, ruler[1].point);
  return figure(distance, sigmaOf(distance));
};
function tellMeasure() {
  const said = byId('measured');
  said.hidden = !measuring && !ruler.length;
  if (ruler.length < 2) {
    said.textContent = ruler.length ? 'Pick the second point.' : 'Pick two points of the model.';
    return;
  }
  const [a, b] = ruler.map((one) => one.point);
  const rise = b[1] - a[1], level = Math.hypot(b[0] - a[0], b[2] - a[2]), distance = length(a, b);
  const [whole, flat, up] = [distance, level, rise].map((value) => figure(value, sigmaOf(value)));
  said.textContent = `Distance ${whole}, level ${flat}, height ${up}.`
    + (how.said ? ` ${how.said[0].toUpperCase()}${how.said.slice(1)}.` : '') + ' ± is one standard deviation.';
}
const measureWith = async (event) => {
  const box = canvas.getBoundingClientRect();
  const found = await pickPoint(event.clientX - box.left, event.clientY - box.top);
  if (!found) {
    byId('measured').textContent = 'There is nothing of the model: pick another point.';
    return;
  }
  ruler = ruler.length === 2 ? [found] : [...ruler, found];
  tellMeasure();
  repaint();
};
byId('measuring').addEventListener('click', () => {
  measuring = !measuring;
  if (!measuring) ruler = [];
  document.body.classList.toggle('measuring', measuring);
  byId('measuring').setAttribute('aria-pressed', String(measuring));
  byId('measuring').textContent = measuring ? 'End measuring' : 'Measure a distance';
  tellMeasure();
  repaint();
  if (measuring && narrow.matches) fold(true);
});
// A click that measures does not move the view, which it would else turn about from then on.
const fire = viewer.events.fire.bind(viewer.events);
viewer.events.fire = (name, ...given) => (measuring && (name === 'orbitTarget:set' || name === 'pick') ? viewer.events : fire(name, ...given));
let pressed = null;
byId('scene').addEventListener('pointerdown', (event) => { pressed = event; }, true);
byId('scene').addEventListener('pointerup', (event) => {
  const still = pressed && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 6;
  if (measuring && picker && still && event.button === 0 && event.target.tagName === 'CANVAS') measureWith(event);
}, true);

// Where the ray through the middle of the picture meets the ground; null where it does not.
const groundAhead = () => {
  const eye = camera().getPosition(), ahead = camera().forward;
  const far = ahead.y < 0 ? (how.ground - eye.y) / ahead.y : -1;
  return far > 0 ? [eye.x + far * ahead.x, how.ground, eye.z + far * ahead.z] : null;
};
function drawScale() {
  const at = viewer.state.loaded && camera() ? groundAhead() : null, bar = byId('scale');
  bar.hidden = !at;
  if (!at) return;
  const pixel = pixelAt(at), most = Math.min(140, canvas.clientWidth / 3) * pixel, power = 10 ** Math.floor(Math.log10(most));
  const round = [5, 2, 1].find((step) => step * power <= most) * power;
  bar.querySelector('div').style.width = `${round / pixel}px`;
  bar.querySelector('span').textContent = `${Number(round.toPrecision(1))} ${how.unit}`;
  bar.dataset.length = round;
}

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
    colors = told.colors;
    const ground = camera()?.camera, level = (place) => parseInt(told.ground.slice(place, place + 2), 16) / 255;
    if (ground) ground.clearColor = Object.assign(ground.clearColor.clone(), { r: level(1), g: level(3), b: level(5) });
    if (told.look && told.look.number !== looked) {
      looked = told.look.number;
      flyTo(told.look);
    }
    repaint();
  };
  new MutationObserver(obey).observe(frame, { attributes: true, attributeFilter: ['data-told'] });
  const ready = () => { if (viewer.state.loaded) { frame.dataset.loaded = ''; obey(); } };
  viewer.events.on('loaded:changed', ready);
  ready();
}
