// SPDX-License-Identifier: Apache-2.0
// The page: shows what the server sends ten times a second, answers each frame, sends what is pressed.
"use strict";

const WINDOW = 30; // s of traces
const SILENT = 1000; // ms without a frame after which the connection is taken for lost
const RETRY = 500; // ms between attempts to connect
const GIVEN_UP = 3000; // ms of silence after which a connection is replaced by a new one
const SURE = 4000; // ms within which a button is pressed again
const COLOURS = ["#0b5fd0", "#c2410c", "#0b6b2e", "#7c3aed", "#b00020", "#0e7490", "#6b7280", "#a16207"];
const REFUSED = 4401, FULL = 4429;

const find = (id) => document.getElementById(id);
const charts = {};
let socket = null, rig = null, heard = 0, begun = 0, entered = false, refused = false;
let operates = true; // false: this page only watches
let wanted = false; // STOP has been pressed here, and the server has not confirmed it yet
let token = "";

// what is written after # never leaves the browser; it is not left in the address either
try {
  token = location.hash.startsWith("#token=") ? decodeURIComponent(location.hash.slice(7)) : sessionStorage.getItem("token") || "";
} catch { token = ""; }
if (location.hash) history.replaceState(null, "", location.pathname);

// ---------------------------------------------------------------- connection

function connect() {
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket = opened;
  begun = performance.now();
  opened.onopen = () => opened.send(JSON.stringify({ token }));
  opened.onmessage = (event) => {
    if (opened !== socket) return;
    heard = performance.now();
    const content = JSON.parse(event.data);
    if (content.hello) enter(content.hello);
    else {
      opened.send(JSON.stringify({ got: content.number }));
      show(content);
    }
  };
  opened.onclose = (event) => {
    if (opened !== socket) return;
    socket = null;
    entered = false;
    refused = event.code === REFUSED;
    if (refused) askForToken("Wrong token.");
    else setTimeout(connect, RETRY);
    watch(event.code === FULL ? "Too many pages are open." : "");
  };
}

function connected() {
  return entered && socket !== null && socket.readyState === WebSocket.OPEN && performance.now() - heard < SILENT;
}

function send(message) {
  if (socket !== null && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function askForToken(note) {
  find("enter").hidden = false;
  find("enter-note").textContent = note;
  find("enter-token").hidden = false;
}

find("enter").addEventListener("submit", (event) => {
  event.preventDefault();
  token = find("token").value.trim();
  refused = false;
  if (socket !== null) socket.close(); // it is replaced by one with the token
  else connect();
});

function enter(hello) {
  entered = true;
  operates = hello.operate;
  if (token && operates) sessionStorage.setItem("token", token);
  find("enter").hidden = operates;
  if (operates) find("token").blur(); // else a space typed there, unseen, would be no STOP
  find("enter-note").textContent = "This page only watches: it has no STOP.";
  find("enter-token").hidden = !hello.token;
  find("stop").hidden = find("controls").hidden = !operates;
  document.querySelector("main").hidden = false;
  if (JSON.stringify(rig) !== JSON.stringify(hello.rig)) {
    rig = hello.rig;
    drawAll();
  }
  document.title = `${rig.name} - abrace`;
  if (wanted && operates) send({ do: "stop" });
}

// says loudly that what is shown is old, and that STOP does not reach the rig
function watch(why = "") {
  // a network that was cut closes no connection: STOP would wait for the old one for minutes
  if (socket !== null && !refused && performance.now() - Math.max(heard, begun) > GIVEN_UP) {
    const old = socket;
    socket = null;
    entered = false;
    old.close();
    connect();
  }
  const lost = !connected();
  const alarm = find("alarm");
  document.querySelector("main").classList.toggle("old", lost);
  if (lost) {
    const pressed = wanted ? "STOP was pressed: it is sent as soon as the connection is back. " : "";
    const useless = operates ? "STOP on this page does not reach the rig now: use the hardware's button. " : "";
    write(alarm, `NO CONNECTION. ${pressed}${useless}What is shown is old. ${why}`);
    alarm.dataset.kind = "lost";
    alarm.hidden = refused || rig === null && performance.now() < SILENT;
    setState("no connection", "lost", "", "");
    find("stop-note").textContent = "NO CONNECTION";
  } else if (alarm.dataset.kind === "lost") {
    alarm.hidden = true;
    alarm.dataset.kind = "";
  }
}
setInterval(watch, 200);

// ---------------------------------------------------------------- what is pressed

function stop() {
  wanted = true;
  send({ do: "stop" });
  find("stop").classList.add("pressed");
  find("stop-note").textContent = connected() ? "sent" : "NO CONNECTION";
}

// as a mushroom button: when it goes down, not when it comes up
find("stop").addEventListener("pointerdown", (event) => { event.preventDefault(); stop(); });
find("stop").addEventListener("click", stop); // of a screen reader, and Enter
window.addEventListener("keydown", (event) => {
  const typing = event.target === find("token");
  if (!operates) return;
  if (event.key === "Escape" || (event.key === " " && !typing)) {
    event.preventDefault();
    event.stopImmediatePropagation();
    stop();
  }
}, true);
// a key that is held down presses a button once: again is a decision
window.addEventListener("keydown", (event) => {
  if (event.key === "Enter" && event.repeat && event.target instanceof HTMLButtonElement) event.preventDefault();
}, true);
// the space bar presses the button in focus when it comes up
window.addEventListener("keyup", (event) => {
  if (event.key === " " && operates && event.target !== find("token")) event.preventDefault();
}, true);

// a button that moves or erases something is pressed twice
function press(button) {
  if (button.dataset.sure && !button.classList.contains("sure")) {
    button.classList.add("sure");
    button.dataset.words = button.textContent;
    button.textContent = "Press again: " + button.dataset.words;
    named(button);
    setTimeout(() => unsure(button), SURE);
    return;
  }
  unsure(button);
  if (button.dataset.do === "release") wanted = false;
  if (connected()) send({ do: button.dataset.do, node: button.dataset.node || "" });
}

function unsure(button) {
  if (!button.classList.contains("sure")) return;
  button.classList.remove("sure");
  button.textContent = button.dataset.words;
  named(button);
}

// of the buttons in rows one hears whose they are
function named(button) {
  if (button.dataset.node) button.setAttribute("aria-label", `${button.textContent} ${button.dataset.node}`);
}

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element && event.target.closest("button[data-do]");
  if (button) press(button);
});

// ---------------------------------------------------------------- what is shown

// what has not changed is not written: a screen reader would say it again
function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function setState(words, level, why, now) {
  const name = rig === null || level === "lost" ? "" : `${rig.name}: `;
  if (find("state").textContent !== name + words) {
    const first = document.createElement("span");
    first.id = "rig-name";
    first.textContent = name;
    find("state").replaceChildren(first, words);
  }
  write(find("why"), why);
  write(find("now"), why && now ? `; ${now}` : now);
  find("rig").className = level;
}

function show(frame) {
  const { sample } = frame;
  const age = sample.age ? `no samples of the rig for ${sample.age} s` : "";
  const joined = (...parts) => parts.filter(Boolean).join("; ");
  const why = joined(sample.wrong, sample.cause, frame.stop && `STOP on the page: ${frame.stop}`);
  setState(sample.state, sample.wrong ? "fault" : sample.level, why, joined(age, ...sample.limited));
  if (frame.stop) wanted = false;
  find("stop").classList.toggle("pressed", Boolean(frame.stop) || wanted);
  find("stop-note").textContent = frame.stop ? "PRESSED" : wanted ? "sent" : "Esc or space";
  if (!frame.stop && document.activeElement === find("release")) find("controls").focus();
  find("release").hidden = !frame.stop;
  trace(frame.traces);
  rows("recording", frame.recording.map((one) => ({ bad: one.bad, cells: [one.node, one.state, one.messages, one.lost, one.file, one.waits] })));
  rows("latency", frame.latency.map((one) => ({ key: `${one.node} ${one.what}`, cells: [one.node, one.what, ...one.times, one.late] })));
  rows("nodes", frame.nodes.map((one) => ({ bad: one.level !== "ok", cells: [one.name, one.state, one.rate === null ? "-" : Math.round(one.rate), one.lost ?? "-"], node: one.name, actions: operates ? one.actions : [] })));
  bars("interlocks", frame.interlocks.map((one) => ({ name: one.name, share: one.share / 100, words: `${one.share} %` })));
  frame.events.forEach(happened);
  watch();
}

const WORDS = { arm: "Arm", disarm: "Disarm", clear: "Clear", play: "Play" };

// the page's elements are changed only where their content has: a button that is pressed or in focus stays, with its row
function rows(id, wantedRows) {
  const body = find(id).tBodies[0], labels = [...find(id).tHead.rows[0].cells].map((one) => one.textContent);
  const keyOf = (row) => row.key ?? row.cells[0];
  const keys = new Set(wantedRows.map(keyOf));
  [...body.rows].filter((one) => !keys.has(one.dataset.key)).forEach((one) => one.remove());
  wantedRows.forEach((row, index) => {
    let element = body.rows[index];
    if (!element || element.dataset.key !== keyOf(row)) {
      element = body.insertRow(index);
      element.dataset.key = keyOf(row);
      element.tabIndex = -1;
    }
    element.className = row.bad ? "bad" : "";
    row.cells.forEach((content, column) => {
      const cell = element.cells[column] ?? element.insertCell();
      if (column) cell.dataset.label = labels[column];
      write(cell, String(content));
    });
    if (row.actions) buttons(element, element.cells[row.cells.length] ?? element.insertCell(), row);
  });
}

function buttons(element, cell, { actions, node }) {
  for (const button of [...cell.children]) {
    if (actions.includes(button.dataset.do)) continue;
    if (button === document.activeElement) element.focus(); // on no other button: what it does is another thing
    button.remove();
  }
  actions.forEach((action, index) => {
    if (cell.children[index]?.dataset.do === action) return;
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = WORDS[action];
    button.dataset.do = action;
    button.dataset.node = node;
    button.dataset.sure = action === "disarm" ? "" : "1";
    named(button);
    cell.insertBefore(button, cell.children[index] ?? null);
  });
}

function bars(id, wantedBars) {
  const place = find(id);
  while (place.children.length > wantedBars.length) place.lastChild.remove();
  wantedBars.forEach((bar, index) => {
    let element = place.children[index];
    if (!element) {
      element = document.createElement("div");
      element.append(document.createElement("span"), document.createElement("progress"), document.createElement("span"));
      place.append(element);
    }
    const [name, progress, words] = element.children;
    const level = bar.share >= 1 ? "over" : bar.share >= 0.9 ? "near" : "";
    const note = level === "over" ? " AT THE LIMIT" : level === "near" ? " near" : "";
    write(name, bar.name);
    write(words, bar.words + note);
    progress.value = Math.min(bar.share, 1);
    progress.setAttribute("aria-label", bar.name);
    element.className = `bar ${level}`;
  });
}

const MOST_EVENTS = 50;

function happened(event) {
  const item = document.createElement("li");
  item.textContent = `${new Date(1000 * event.time).toLocaleTimeString()}  ${event.text}`;
  if (event.bad) item.className = "bad";
  find("events").prepend(item);
  find("events").tabIndex = 0; // keys scroll it
  while (find("events").children.length > MOST_EVENTS) find("events").lastChild.remove();
}

// ---------------------------------------------------------------- traces

function drawAll() {
  for (const [id, pattern] of [["displacement-trace", /^x/], ["acceleration-trace", /^[aw]/], ["force-trace", /^[fU]/]]) {
    if (charts[id]) charts[id].plot.destroy();
    delete charts[id];
    const columns = rig.channels.flatMap((name, column) => (pattern.test(name) ? [column] : []));
    find(id).closest("section").hidden = !columns.length;
    if (!columns.length) continue;
    const series = columns.map((column, index) => ({ label: rig.channels[column], stroke: COLOURS[index % COLOURS.length], width: 1, points: { show: false } }));
    const size = { width: Math.max(280, find(id).clientWidth), height: 200 };
    const plot = new uPlot({
      ...size, series: [{ label: "s" }, ...series], scales: { x: { time: false } }, cursor: { show: false },
      axes: [{ label: "s of this run", labelSize: 18, labelFont: "12px system-ui" }, { size: 60, space: 24 }], legend: { show: true, live: false },
    }, [[], ...columns.map(() => [])], find(id));
    charts[id] = { plot, columns, data: [[], ...columns.map(() => [])] };
  }
  building.clear();
  find("forces").replaceChildren();
  find("floors").tBodies[0].replaceChildren();
  drawFloors();
}

const FLOOR_COLUMNS = [
  { letter: "x", id: "displacement-trace", words: "displacement mm", digits: 2 },
  { letter: "a", id: "acceleration-trace", words: "acceleration m/s²", digits: 3 },
];

// number of floors on which it is measured
function measured(letter) {
  return rig.heights.filter((_, index) => rig.channels.includes(`${letter}${index + 1}`)).length;
}

// what is not measured has no column, and the building says what it cannot show
function drawFloors() {
  const heads = ["floor", ...FLOOR_COLUMNS.filter(({ letter }) => measured(letter)).flatMap(({ words }) => [words, "peak of 30 s"])];
  find("floors").tHead.rows[0].replaceChildren(...heads.map((words) => {
    const head = document.createElement("th");
    head.textContent = words;
    return head;
  }));
  find("floors").closest("section").hidden = heads.length === 1;
  const moving = measured("x");
  find("enlarged").hidden = !moving;
  find("building").setAttribute("aria-label", `the building${moving ? ", its displacements enlarged" : " at rest"}, and its braces, coloured by their force over the capacity`);
  find("not-measured").hidden = moving === rig.heights.length;
  find("not-measured").textContent = moving
    ? "Floors in light grey have no displacement sensor: they are drawn between their neighbours."
    : "No displacement is measured: the building is drawn at rest.";
}

const widths = new ResizeObserver(() => {
  for (const [id, { plot }] of Object.entries(charts)) plot.setSize({ width: Math.max(280, find(id).clientWidth), height: 200 });
});
document.querySelectorAll(".trace").forEach((each) => widths.observe(each));

function animate(now) {
  building.advance(now);
  const times = 10 ** find("exaggeration").value;
  find("times").textContent = times < 10 ? times.toFixed(1) : Math.round(times);
  if (rig !== null) drawBuilding(find("building"), rig, times);
  requestAnimationFrame(animate);
}

// each bin is two points, its least and its greatest value, half a bin apart
function trace(given) {
  for (const [id, chart] of Object.entries(charts)) {
    if (given.anew) chart.data.forEach((one) => { one.length = 0; });
    given.begin.forEach((begin, bin) => {
      chart.data[0].push(begin, begin + 0.02);
      chart.columns.forEach((column, index) => chart.data[index + 1].push(given.low[bin][column] ?? null, given.high[bin][column] ?? null));
    });
    const times = chart.data[0];
    const old = times.findIndex((time) => time >= times[times.length - 1] - WINDOW);
    if (old > 0) chart.data.forEach((one) => one.splice(0, old));
    if ((given.begin.length || given.anew) && !document.hidden) {
      chart.plot.setData(chart.data, false);
      const end = times.length ? times[times.length - 1] : WINDOW;
      chart.plot.batch(() => {
        chart.plot.setScale("x", { min: Math.max(0, end - WINDOW), max: Math.max(end, 1) });
        rescale(chart);
      });
    }
  }
  if (given.anew) building.clear();
  given.begin.forEach((_, bin) => move(given.low[bin], given.high[bin]));
  if (given.begin.length || given.anew) numbers();
}

// a bin for the building: floors in the middle of their range, braces at their greatest force
function move(low, high) {
  const of = (name) => rig.channels.indexOf(name);
  const known = (column) => Number.isFinite(low[column]) && Number.isFinite(high[column]);
  const middle = (column) => (known(column) ? (low[column] + high[column]) / 2000 : null);
  const most = (column) => Math.max(Math.abs(low[column]), Math.abs(high[column]));
  building.add(rig.heights.map((_, floor) => middle(of(`x${floor + 1}`))), rig.groups.map(({ name, capacity }) => (known(of(name)) ? most(of(name)) / capacity : null)));
}

function greatest(values) {
  return values.reduce((most, value) => Math.max(most, Math.abs(value ?? 0)), 0);
}

function rescale(chart) {
  const least = 0.1;
  const reach = Math.max(least, 1.1 * Math.max(...chart.data.slice(1).map(greatest)));
  chart.plot.setScale("y", { min: -reach, max: reach });
}

// of the last bin the value that is further from zero; null: none was measured
function present(values) {
  return values.slice(-2).reduce((most, value) => (value !== null && Math.abs(value) >= Math.abs(most ?? 0) ? value : most), null);
}

function numbers() {
  const of = (id, name) => charts[id].data[1 + charts[id].columns.indexOf(rig.channels.indexOf(name))];
  const there = (name) => rig.channels.includes(name);
  const shown = FLOOR_COLUMNS.filter(({ letter }) => measured(letter));
  const both = ({ letter, id, digits }, floor) => {
    if (!there(letter + floor)) return ["", ""];
    return [present, greatest].map((each) => each(of(id, letter + floor))?.toFixed(digits) ?? "-");
  };
  rows("floors", rig.heights.map((_, index) => ({
    cells: [`floor ${index + 1}`, ...shown.flatMap((column) => both(column, index + 1))],
  })).filter(({ cells }) => cells.slice(1).some(Boolean)).reverse());
  bars("forces", rig.groups.filter(({ name }) => there(name)).map(({ name, floor, capacity }) => {
    const force = present(of("force-trace", name));
    return { name: `${name}, floor ${floor}`, share: Math.abs(force ?? 0) / capacity, words: `${force?.toFixed(2) ?? "-"} of ${capacity.toFixed(1)} kN` };
  }));
}

new ResizeObserver(() => {
  // what the keys bring into focus is not hidden by the header
  document.documentElement.style.scrollPaddingTop = `${document.querySelector("header").offsetHeight + 12}px`;
}).observe(document.querySelector("header"));
requestAnimationFrame(animate);
connect();
