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
    alarm.textContent = `NO CONNECTION. ${pressed}${useless}What is shown is old. ${why}`;
    alarm.dataset.kind = "lost";
    alarm.hidden = refused || rig === null && performance.now() < SILENT;
    setState("no connection", "lost", "");
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
}

document.addEventListener("click", (event) => {
  const button = event.target instanceof Element && event.target.closest("button[data-do]");
  if (button) press(button);
});

// ---------------------------------------------------------------- what is shown

function setState(words, level, cause) {
  const text = rig === null || level === "lost" ? words : `${rig.name}: ${words}`;
  if (find("state").textContent !== text) find("state").textContent = text;
  if (find("cause").textContent !== cause) find("cause").textContent = cause;
  find("rig").className = level;
}

function show(frame) {
  const { sample } = frame;
  const age = sample.age ? `no samples of the rig for ${sample.age} s` : "";
  const cause = [sample.wrong, sample.cause, age, ...sample.limited, frame.stop && `STOP on the page: ${frame.stop}`];
  setState(sample.state, sample.wrong ? "fault" : sample.level, cause.filter(Boolean).join("; "));
  if (frame.stop) wanted = false;
  find("stop").classList.toggle("pressed", Boolean(frame.stop) || wanted);
  find("stop-note").textContent = frame.stop ? "PRESSED" : wanted ? "sent" : "Esc or space";
  find("release").hidden = !frame.stop;
  trace(frame.traces);
  rows("recording", frame.recording.map((one) => ({ bad: one.bad, cells: [one.node, one.state, one.messages, one.lost, one.file, one.waits] })));
  rows("latency", frame.latency.map((one) => ({ cells: [one.node, one.what, ...one.times, one.late] })));
  rows("nodes", frame.nodes.map((one) => ({ bad: one.level !== "ok", cells: [one.name, one.state, one.rate === null ? "-" : Math.round(one.rate), one.lost ?? "-"], node: one.name, actions: operates ? one.actions : [] })));
  bars("interlocks", frame.interlocks.map((one) => ({ name: one.name, share: one.share / 100, words: `${one.share} %` })));
  frame.events.forEach(happened);
  watch();
}

const WORDS = { arm: "Arm", disarm: "Disarm", clear: "Clear", play: "Play" };

// the page's elements are changed only where their content has: a button that is being pressed stays
function rows(id, wantedRows) {
  const body = find(id).tBodies[0];
  while (body.rows.length > wantedRows.length) body.deleteRow(-1);
  wantedRows.forEach((row, index) => {
    const text = JSON.stringify(row);
    let element = body.rows[index];
    if (element && element.dataset.content === text) return;
    if (element && element.querySelector("button.sure")) return;
    if (!element) element = body.insertRow();
    element.dataset.content = text;
    element.className = row.bad ? "bad" : "";
    element.replaceChildren(...row.cells.map((cell) => cellOf(cell)), ...(row.actions ? [buttonsOf(row)] : []));
  });
}

function cellOf(content) {
  const cell = document.createElement("td");
  cell.textContent = content;
  return cell;
}

function buttonsOf(row) {
  const cell = document.createElement("td");
  for (const action of row.actions) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = WORDS[action];
    button.dataset.do = action;
    button.dataset.node = row.node;
    button.dataset.sure = action === "disarm" ? "" : "1";
    cell.append(button, " ");
  }
  return cell;
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
    if (name.textContent !== bar.name) name.textContent = bar.name;
    if (words.textContent !== bar.words + note) words.textContent = bar.words + note;
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
  while (find("events").children.length > MOST_EVENTS) find("events").lastChild.remove();
}

// ---------------------------------------------------------------- traces

function drawAll() {
  for (const [id, pattern] of [["displacement-trace", /^x/], ["acceleration-trace", /^[aw]/], ["force-trace", /^[fU]/]]) {
    if (charts[id]) charts[id].plot.destroy();
    const columns = rig.channels.flatMap((name, column) => (pattern.test(name) ? [column] : []));
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
}

window.addEventListener("resize", () => {
  for (const [id, { plot }] of Object.entries(charts)) plot.setSize({ width: Math.max(280, find(id).clientWidth), height: 200 });
});

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
  const middle = (column) => (column < 0 ? null : ((low[column] ?? 0) + (high[column] ?? 0)) / 2000);
  const most = (column) => (column < 0 ? null : Math.max(Math.abs(low[column] ?? 0), Math.abs(high[column] ?? 0)));
  building.add(rig.heights.map((_, floor) => middle(of(`x${floor + 1}`))), rig.groups.map(({ name, capacity }) => (of(name) < 0 ? null : most(of(name)) / capacity)));
}

function greatest(values) {
  return values.reduce((most, value) => Math.max(most, Math.abs(value ?? 0)), 0);
}

function rescale(chart) {
  const least = 0.1;
  const reach = Math.max(least, 1.1 * Math.max(...chart.data.slice(1).map(greatest)));
  chart.plot.setScale("y", { min: -reach, max: reach });
}

// of the last bin the value that is further from zero
function present(values) {
  const [low, high] = values.slice(-2).map((value) => value ?? 0);
  return Math.abs(low ?? 0) > Math.abs(high ?? 0) ? low : high ?? 0;
}

function numbers() {
  const of = (id, name) => charts[id].data[1 + charts[id].columns.indexOf(rig.channels.indexOf(name))];
  const both = (id, name, digits) => (rig.channels.includes(name) ? [present, greatest].map((each) => each(of(id, name)).toFixed(digits)) : ["", ""]);
  rows("floors", rig.heights.map((_, index) => ({
    cells: [`floor ${index + 1}`, ...both("displacement-trace", `x${index + 1}`, 2), ...both("acceleration-trace", `a${index + 1}`, 3)],
  })).reverse());
  bars("forces", rig.groups.filter(({ name }) => rig.channels.includes(name)).map(({ name, floor, capacity }) => {
    const force = present(of("force-trace", name));
    return { name: `${name}, floor ${floor}`, share: Math.abs(force) / capacity, words: `${force.toFixed(2)} of ${capacity.toFixed(1)} kN` };
  }));
}

requestAnimationFrame(animate);
connect();
