// SPDX-License-Identifier: Apache-2.0
// The building in motion: floors moved by their displacements, enlarged, and braces coloured by force over capacity.
"use strict";

const HALF_WIDTH = 2.25; // m of a floor, as drawn
const BATCH = 100; // ms between frames of the server, over which the bins of one are played

const building = {
  queue: [], // bins to come, each { sway: [m of each floor], share: [of each group] }
  place: 0, // between the first of them and the second
  time: 0,

  clear() {
    this.queue.length = 0;
    this.place = 0;
  },

  add(sway, share) {
    this.queue.push({ sway, share });
    while (this.queue.length > 1000) this.queue.shift();
  },

  // as many bins as wait, evenly over the time until the next ones come
  advance(now) {
    const ahead = this.queue.length - 1;
    this.place += ahead * Math.min((now - this.time) / BATCH, 1);
    this.time = now;
    while (this.place >= 1 && this.queue.length > 1) {
      this.place -= 1;
      this.queue.shift();
    }
    this.place = Math.min(this.place, 1);
  },

  now() {
    const [one, next = one] = this.queue;
    const between = (name) => one[name].map((value, index) => (value === null ? null : value + this.place * ((next[name][index] ?? value) - value)));
    return { sway: between("sway"), share: between("share") };
  },
};

// floors between sensors as on a straight line between their neighbours; those above the highest sensor move with it
function complete(sway, levels) {
  return sway.map((value, floor) => {
    if (value !== null) return value;
    const below = sway.findLastIndex((one, other) => one !== null && other < floor);
    const above = sway.findIndex((one, other) => one !== null && other > floor);
    if (above < 0) return sway[below];
    return sway[below] + (sway[above] - sway[below]) * (levels[floor] - levels[below]) / (levels[above] - levels[below]);
  });
}

function colourOf(share) { // green over yellow at a half to red, grey where no force is measured
  if (share === null) return "#6b7580";
  return `hsl(${120 * (1 - Math.min(Math.max(share, 0), 1))}, 75%, 38%)`;
}

function drawBuilding(canvas, rig, times) {
  const scale = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (!width || !building.queue.length) return;
  canvas.width = width * scale;
  canvas.height = height * scale;
  const pen = canvas.getContext("2d");
  pen.scale(scale, scale);
  pen.font = "13px system-ui, sans-serif";
  pen.lineCap = "round";
  const { sway: moved, share } = building.now();
  const levels = [0, ...rig.heights], measured = [true, ...moved.map((value) => value !== null)];
  const sway = complete([0, ...moved], levels).map((value) => times * value);
  const unit = Math.min((height - 50) / levels[levels.length - 1], width / 9);
  const at = (x, z) => [width / 2 + unit * x, height - 25 - unit * z];
  const line = (colour, thickness, points) => {
    pen.strokeStyle = colour;
    pen.lineWidth = thickness;
    pen.beginPath();
    points.forEach(([x, y], number) => (number ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.stroke();
  };
  line("#111", 5, [at(-HALF_WIDTH - 0.6, 0), at(HALF_WIDTH + 0.6, 0)]);
  rig.groups.forEach(({ floor, cosine }, group) => {
    const below = floor - 1, storey = levels[floor] - levels[below];
    const reach = Math.min(storey * cosine / Math.sqrt(Math.max(1 - cosine ** 2, 1e-6)), 2 * HALF_WIDTH) / 2;
    line(colourOf(share[group]), 7, [at(sway[below] - reach, levels[below]), at(sway[floor] + reach, levels[floor])]);
    const words = share[group] === null ? "" : `${Math.round(100 * share[group])} %`;
    const [x, y] = at((sway[below] + sway[floor]) / 2 + HALF_WIDTH + 0.3, (levels[below] + levels[floor]) / 2);
    pen.fillStyle = "#111";
    pen.fillText(words, Math.min(x, width - pen.measureText(words).width - 4), y);
  });
  for (let floor = 1; floor < levels.length; floor += 1) {
    const below = floor - 1;
    for (const side of [-HALF_WIDTH, HALF_WIDTH]) {
      const parts = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10].map((part) => part / 10);
      line("#6b7580", 3, parts.map((s) => at(side + sway[below] + (sway[floor] - sway[below]) * (3 * s * s - 2 * s * s * s), levels[below] + s * (levels[floor] - levels[below]))));
    }
    line(measured[floor] ? "#6b7580" : "#b8bfc6", 8, [at(sway[floor] - HALF_WIDTH, levels[floor]), at(sway[floor] + HALF_WIDTH, levels[floor])]);
  }
}
