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
nav { border-bottom: 1px solid var(--rule); }
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
figure > div { width: 100%; max-width: calc(var(--w) * 1px); }
figure img { max-width: 100%; }
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
  return new Response(packed.body.pipeThrough(new DecompressionStream("gzip"))).text();
};
const draw = async () => {
  const [code, text] = await Promise.all(["plotly", "figures"].map(unpacked));
  const script = document.createElement("script");
  script.textContent = code;
  document.head.append(script);
  const figures = JSON.parse(text);
  for (const place of document.querySelectorAll("[data-figure]")) {
    const { data, layout } = figures[place.dataset.figure];
    const width = Math.min(layout.width, place.clientWidth || layout.width);
    place.style.setProperty("--drawn", width);
    const sized = { ...layout, width, height: layout.height * width / layout.width };
    await Plotly.newPlot(place, data, sized, { displaylogo: false, responsive: false });
  }
  document.documentElement.dataset.drawn = Object.keys(figures).length;
};
draw().catch(error => {
  console.error(error);
  const line = document.createElement("p");
  line.id = "failed";
  line.textContent = `The figures cannot be drawn here (${error}); they are in the folder of this page as PNG and SVG.`;
  document.querySelector("main").prepend(line);
});
"""
