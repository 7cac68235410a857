# SPDX-License-Identifier: Apache-2.0
"""The style of a report's page, for screen and paper, and the script that draws its figures."""

STYLE = """
:root { --blue: #1b3a6b; --rule: #d5d9e0; }
body { font: 15px/1.5 system-ui, "DejaVu Sans", Verdana, sans-serif; color: #1c1c1c; }
body { margin: 0 auto; max-width: 1300px; padding: 0 20px 60px; }
header { border-bottom: 3px solid var(--blue); margin: 24px 0 8px; }
h1 { margin: 0; color: var(--blue); }
header p { margin: 2px 0 10px; color: #555; }
nav { position: sticky; top: 0; z-index: 9; background: white; padding: 6px 0; font-size: 13px; }
nav { border-bottom: 1px solid var(--rule); display: flex; flex-wrap: wrap; }
nav a { margin-right: 14px; color: var(--blue); text-decoration: none; white-space: nowrap; }
h2 { margin: 34px 0 8px; color: var(--blue); scroll-margin-top: 48px; }
h3 { margin: 22px 0 4px; font-size: 15px; }
section { scroll-margin-top: 40px; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { padding: 2px 10px; text-align: right; white-space: nowrap; border-bottom: 1px solid #eceef2; }
th { border-bottom: 1.5px solid #888; font-weight: 600; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
.note { margin: 3px 0; font-size: 13px; color: #444; }
pre { font-size: 12px; background: #f5f6f8; padding: 10px; overflow-x: auto; }
figure { margin: 20px 0 26px; break-inside: avoid; }
figure > div { width: 100%; max-width: 1060px; }
figure img { max-width: 100%; height: auto; }
figcaption { font-size: 13px; color: #333; margin-top: 4px; max-width: 900px; }
#failed { background: #fbe9e7; padding: 8px 12px; }
@page { size: A4; margin: 15mm; }
@media print {
  body { font-size: 10pt; max-width: none; padding: 0; }
  nav, .modebar { display: none !important; }
  .wide { overflow: visible; }
  table { font-size: 7.5pt; } th, td { white-space: normal; padding: 1px 5px; }
  pre { white-space: pre-wrap; word-break: break-all; font-size: 7pt; }
  h2, h3 { break-after: avoid; } tr { break-inside: avoid; }
  figure > div { zoom: calc(640 / max(var(--drawn, 640), 640)); }
}
"""

SCRIPT = """
const unpacked = async name => {
  const packed = await fetch("data:application/gzip;base64," + document.getElementById(name).textContent);
  return new Response(packed.body.pipeThrough(new DecompressionStream("gzip")));
};
const addressOf = (text, type) => URL.createObjectURL(new Blob([text], { type }));
const loaded = element => new Promise((done, failed) => Object.assign(element, { onload: done, onerror: failed }));
const draw = async () => {
  const figures = await (await unpacked("figures")).json();
  const charts = [];
  for (const place of document.querySelectorAll("[data-figure]")) {
    const figure = figures[place.dataset.figure];
    if (typeof figure !== "string") { charts.push([place, figure]); continue; }
    const image = Object.assign(new Image(), { alt: place.title, src: addressOf(figure, "image/svg+xml") });
    place.append(image);
    await image.decode();
  }
  if (charts.length) {
    const code = document.createElement("script");
    code.src = addressOf(await (await unpacked("plotly")).text(), "text/javascript");
    document.head.append(code);
    await loaded(code);
  }
  for (const [place, { data, layout }] of charts) {
    place.style.setProperty("--drawn", place.clientWidth);
    const options = { displaylogo: false, responsive: true, modeBarButtons: [["resetScale2d", "toImage"]] };
    await Plotly.newPlot(place, data, { ...layout, width: place.clientWidth }, options);
    await new Promise(done => setTimeout(done));  // meanwhile the page can be read and scrolled
  }
  document.documentElement.dataset.drawn = Object.keys(figures).length;
};
draw().catch(error => {
  console.error(error);
  const line = document.createElement("p");
  line.id = "failed";
  line.textContent = `The figures cannot be drawn here (${error}); they are in the folder of this page as SVG.`;
  document.querySelector("main").prepend(line);
});
"""
