// The page on which a run is chosen, begun and watched. All that is shown of this machine's files is
// set as text, never as markup.
"use strict";
const secret = new URLSearchParams(location.search).get("secret") || "";
const at = (id) => document.getElementById(id);
const address = (path) => `./${path}?secret=${encodeURIComponent(secret)}`;
const say = (text) => { at("message").textContent = text; };
const show = (id, is) => { at(id).hidden = !is; };

let words = null, profiles = {}, source = null, command = null, hasList = false, isOpening = false, atWork = false;
let wish = 0, places = [], curves = [], modelDrawn = 0, sentence = "";

async function ask(name, value = true) {
  const response = await fetch(address(""), { method: "POST", body: JSON.stringify({ [name]: value }) });
  if (!response.ok) throw new Error("the page is not served any more");
  const answer = await response.json();
  if (answer.error) throw new Error(answer.error);
  return answer;
}

function element(tag, text = "", parent = null) {
  const made = document.createElement(tag);
  made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

const quality = () => document.querySelector("[name=quality]:checked").value;
const shellWord = (word) => /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'"'"'`)}'`;

function choice() {
  const kind = at("machines").value;
  const file = kind === "file" ? at("system").value.trim() : kind === "form" ? at("list").value.trim() : "";
  return { path: source.path, out: at("out").value.trim(), quality: quality(), system: file || null, system_as: file || null,
    is_listed: kind === "form" };
}

function isChosen() {
  const kind = at("machines").value;
  return source !== null && source.next !== "open" && at("out").value.trim() !== ""
    && (kind === "here" || (kind === "file" && at("system").value.trim() !== "") || (kind === "form" && hasList && at("list").value.trim() !== ""));
}

function showState() {
  const step = source ? source.next : "", line = step === "open" ? ["inspect", source.path] : command;
  at("start").textContent = words ? words.verbs[step] || "Start" : "Start";
  at("start").disabled = atWork || !(step === "open" || command);
  at("copy").disabled = !line;
  at("line").textContent = line ? `radiant ${line.map(shellWord).join(" ")}` : "";
  if (!step) at("forecast").textContent = words ? words.nothing : "";
  if (step === "open") at("forecast").textContent = "";
  // What is only looked at has no machines and no result, and a run's places are in its own page.
  document.querySelectorAll("[data-makes]").forEach((part) => { part.hidden = step === "open"; });
  show("where", step !== "open" || places.length > 0);
}

async function forecast() {
  command = null;
  const mine = ++wish;
  showState();
  if (!isChosen()) return;
  at("forecast").textContent = "Time: …";
  try {
    const answer = await ask("forecast", choice());
    if (mine !== wish) return;
    command = answer.command;
    at("forecast").textContent = answer.text;
  } catch (error) {
    if (mine === wish) at("forecast").textContent = error.message;
  }
  showState();
}

async function look(path) {
  if (!path) return;
  at("path").value = path;
  show("browser", false);
  show("notes", false);
  source = command = null;
  const mine = ++wish;
  at("found").textContent = `Looking at ${path} …`;
  showState();
  try {
    const found = await ask("look", path);
    if (mine !== wish) return;
    source = found;
    at("found").textContent = `${found.title[0].toUpperCase()}${found.title.slice(1)}.`;
    at("notes").textContent = found.notes.join("\n");
    show("notes", found.notes.length > 0);
    at("out").value = found.out;
    at("list").value = found.list;
    places = found.places;
    at("places").textContent = places.length ? `${places.length.toLocaleString("en")} places by the ${found.places_are}, ${spread(found.unit)}; north is up`
      : "Nothing says yet where the photographs were taken: the run places them.";
    show("where", true);
    drawMap();
    if (found.next === "open") await ask("watch", found.path).then(poll, () => {});
    await forecast();
  } catch (error) {
    if (mine === wish) at("found").textContent = error.message;
  }
  showState();
}

async function browse(path) {
  try {
    const folder = await ask("folder", path), list = at("browser");
    list.replaceChildren();
    at("path").value = folder.path;
    const add = (text, click) => { const one = element("button", text, list); one.onclick = click; return one; };
    add(`Choose ${folder.path}`, () => look(folder.path)).className = "main";
    if (folder.parent) add("↑  the folder above", () => browse(folder.parent));
    const under = (name) => `${folder.path === "/" ? "" : folder.path}/${name}`;
    for (const name of folder.folders) add(`${name}/`, () => browse(under(name)));
    for (const name of folder.files) add(name, () => look(under(name)));
    if (folder.more) element("p", `and ${folder.more} more: type the name`, list);
    list.hidden = false;
    list.scrollTop = 0;
  } catch (error) { say(error.message); }
}

function addMachine() {
  const row = element("tr", "", at("form").querySelector("tbody")), number = row.parentElement.children.length;
  words.columns.forEach((column, place) => {
    const cell = element("td", "", row);
    cell.dataset.label = column;
    if (place === words.kind) {
      const box = element("select", "", cell);
      element("option", words.no_kind, box).value = "";
      for (const [name, machine] of Object.entries(profiles)) { const one = element("option", name, box); one.value = name; one.title = machine; }
    } else {
      const input = element("input", "", cell);
      input.value = place === 1 ? `${words.first_row[1]}-${number}` : words.first_row[place];
      input.setAttribute("aria-label", column);
    }
  });
}

function number(text, ifEmpty) {
  return text.trim() === "" ? ifEmpty : Number.isFinite(Number(text)) ? Number(text) : text;
}

async function writeMachines() {
  hasList = false;
  showState();
  const rows = [...at("form").querySelectorAll("tbody tr")].map((row) => [...row.querySelectorAll("input, select")].map((one) => one.value));
  const machines = rows.map(([site, machine, count, profile, memory, uplink]) => (
    { site, machine, count: number(count, 1), profile, memory_gb: number(memory, null), uplink_mbit_per_s: number(uplink, null) }));
  try {
    await ask("machines", machines);
    hasList = true;
    show("refused", false);
  } catch (error) {
    at("refused").textContent = error.message;
    show("refused", true);
  }
  await forecast();
}

async function onMachines() {
  const kind = at("machines").value;
  show("system", kind === "file");
  show("form", kind === "form");
  show("refused", false);
  if (kind === "form") {
    if (!at("form").querySelector("tbody tr")) addMachine();
    await writeMachines();
  } else await forecast();
}

async function begin() {
  try {
    if (source.next === "open") { await open(source.path); return; }
    const line = at("line").textContent;
    at("start").disabled = true;
    await ask("begin", choice());
    say(`Begun: ${line}`);
  } catch (error) { say(error.message); }
  await poll();
}

async function open(path) {
  say(`Opening ${path} …`);
  try {
    await ask("open", path);
  } catch (error) { say(error.message); return; }
  isOpening = true;
  // The page of the run comes to this address; its picture is there before it.
  for (;;) {
    await new Promise((done) => setTimeout(done, 400));
    const there = await fetch(address("first.jpg")).then((response) => response.ok, () => false);
    if (there) { location.reload(); return; }
  }
}

function spread(unit) {
  const of = (axis) => Math.max(...places.map((one) => one[axis])) - Math.min(...places.map((one) => one[axis]));
  return `${Math.round(of(0))} × ${Math.round(of(1))} ${unit}`;
}

function pen(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas, scale = devicePixelRatio || 1;
  canvas.width = width * scale;
  canvas.height = height * scale;
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  return { context, width, height };
}

function drawMap() {
  const { context, width, height } = pen(at("map"));
  if (!places.length) return;
  const [x, y] = [0, 1].map((axis) => places.map((one) => one[axis])).map((all) => [Math.min(...all), Math.max(...all)]);
  const scale = Math.min((width - 32) / Math.max(x[1] - x[0], 1e-6), (height - 32) / Math.max(y[1] - y[0], 1e-6));
  context.fillStyle = getComputedStyle(document.body).getPropertyValue("--accent");
  for (const [east, north] of places) {
    context.beginPath();
    context.arc(width / 2 + scale * (east - (x[0] + x[1]) / 2), height / 2 - scale * (north - (y[0] + y[1]) / 2), 4, 0, 7);
    context.fill();
  }
}

function drawLoss() {
  const shown = curves.slice(-6);
  show("loss", shown.length > 0);
  show("loss-of", shown.length > 0);
  if (!shown.length) return;
  const { context, width, height } = pen(at("loss")), all = shown.flatMap((curve) => curve.points.map((one) => one[1])).filter((loss) => loss > 0);
  const high = Math.max(...all), low = Math.min(Math.min(...all), 0.9 * high);
  shown.forEach((curve, place) => {
    context.strokeStyle = `hsl(${210 + 55 * place} 70% 50%)`;
    context.lineWidth = place === shown.length - 1 ? 2.2 : 1;
    context.beginPath();
    for (const [share, loss] of curve.points) context.lineTo(8 + share * (width - 16), 8 + (height - 16) * Math.log(high / Math.max(loss, low)) / Math.log(high / low));
    context.stroke();
  });
  const last = shown[shown.length - 1];
  at("loss-of").textContent = `loss of ${last.stage}: ${last.points[last.points.length - 1][1].toPrecision(3)} (between ${low.toPrecision(3)} and ${high.toPrecision(3)})`;
}

function showStages(now) {
  const body = at("stages").querySelector("tbody");
  body.replaceChildren();
  now.stages.forEach((stage, place) => {
    const row = element("tr", "", body), took = stage.seconds === null ? "" : ` in ${stage.seconds < 90 ? `${stage.seconds.toFixed(0)} s` : `${Math.round(stage.seconds / 60)} min`}`;
    element("td", stage.stage, row);
    element("td", stage.state + took, row);
    const bar = element("progress", "", element("td", "", row));
    if (now.shares[place] !== null) bar.value = now.shares[place];
    element("td", stage.note, row).className = "wide soft";
  });
  at("warnings").textContent = now.warnings.join("\n");
}

async function poll() {
  if (isOpening) return;
  let state;
  try {
    state = await ask("state");
  } catch (error) { say(error.message); return; }
  const now = state.progress, isRunning = state.at_work || Boolean(now && now.is_running);
  if (state.reading && at("found").textContent.startsWith("Looking")) at("found").textContent = `Looking: ${state.reading} …`;
  show("watch", Boolean(state.run || state.at_work));
  at("watched").textContent = state.run || state.line;
  at("summary").textContent = state.summary || (state.at_work ? "It begins …" : state.words);
  show("stop", isRunning);
  show("resume", !isRunning && Boolean(now) && ["interrupted", "failed"].includes(now.status));
  // Of a run that was chosen, Open stands beside its line already.
  show("open", !isRunning && state.has_plan && !(source && source.next === "open" && source.path === state.run));
  if (now) { showStages(now); curves = now.losses; drawLoss(); }
  if (!state.at_work && atWork) sentence = state.words || (state.result ? `Finished: ${state.result}` : "It ended without a result");
  if (sentence) { say(sentence); sentence = ""; }
  if (atWork !== state.at_work) {
    atWork = state.at_work;
    const isResult = source && source.next === "run" && at("out").value.trim() === state.run;
    if (isResult) { command = null; at("forecast").textContent = "Another run of these needs another folder."; }
    showState();
    if (!atWork && !isResult && isChosen()) forecast();
  }
  if (state.has_plan && (Date.now() - modelDrawn > 1000 * GROWING_S || (!isRunning && modelDrawn > 0 && at("model").dataset.of !== "all"))) drawModel(state.run, isRunning);
  if (!state.has_plan) show("model", false);
}

function drawModel(run, isRunning) {
  modelDrawn = Date.now();
  const picture = new Image();
  picture.onload = () => { at("model").src = picture.src; at("model").dataset.of = isRunning ? "part" : "all"; at("model").alt = `The model of ${run}`; show("model", true); };
  if (!isRunning) at("model").dataset.of = "all";
  picture.src = `${address("model.webp")}&n=${modelDrawn}`;
}

async function act(name) {
  try { await ask(name); say(name === "stop" ? "The run is being stopped; Resume goes on with it" : "The run begins again where it was"); }
  catch (error) { say(error.message); }
  await poll();
}

async function load() {
  words = await ask("words");
  words.qualities.forEach(([name, title, tip], place) => {
    const label = element("label", "", at("qualities")), input = element("input", "", label);
    label.className = "choice";
    label.title = tip;
    Object.assign(input, { type: "radio", name: "quality", value: name, checked: place === 1, onchange: forecast });
    element("span", title, label);
  });
  const head = element("tr", "", at("form").querySelector("thead"));
  for (const column of words.columns) element("th", column, head);
  at("look").onclick = () => look(at("path").value.trim());
  at("path").onkeydown = (event) => { if (event.key === "Enter") look(at("path").value.trim()); };
  at("browse").onclick = () => browse(at("path").value.trim());
  at("machines").onchange = onMachines;
  for (const id of ["system", "out", "list"]) at(id).onchange = forecast;
  at("form").querySelector("tbody").onchange = writeMachines;
  at("add").onclick = () => { addMachine(); writeMachines(); };
  at("remove").onclick = () => { const rows = at("form").querySelectorAll("tbody tr"); if (rows.length > 1) { rows[rows.length - 1].remove(); writeMachines(); } };
  at("start").onclick = begin;
  at("stop").onclick = () => act("stop");
  at("resume").onclick = () => act("resume");
  at("open").onclick = () => open(at("watched").textContent);
  at("copy").onclick = async () => {
    try {
      if (source.next !== "open") await ask("keep", choice());
      await navigator.clipboard.writeText(at("line").textContent);
      say("Copied: type it in a terminal of the serving machine, with the same result");
    } catch (error) { say(error.message); }
  };
  addEventListener("resize", () => { drawMap(); drawLoss(); });
  showState();
  await poll();
  setInterval(poll, 1000);
  profiles = (await ask("profiles")).profiles;
}
load().catch((error) => say(error.message));
