"use strict";
// Points at a time: a line on every plot of the flight, and the values beside it. Without this script the page shows all the same.
(() => {
  const svgs = [...document.querySelectorAll("svg[data-kind]")].filter((s) => s.dataset.kind !== "plan");
  const plots = svgs.map((svg) => {
    const [x0, x1] = svg.dataset.x.split(" ").map(Number);
    return { svg, x0, x1, section: svg.closest("section"), read: null };
  });
  const series = (plot) => {
    if (plot.read) return plot.read;
    const [y0, y1] = (plot.svg.dataset.y || "0 1").split(" ").map(Number);
    const log = plot.svg.dataset.log;
    const value = (v) => {
      const part = 1 - v / 500;
      return log ? Math.exp(Math.log(y0) + part * Math.log(y1 / y0)) : y0 + part * (y1 - y0);
    };
    const byName = new Map();
    for (const line of plot.svg.querySelectorAll("polyline[data-name]")) {
      const n = line.getAttribute("points").trim().split(" ").map(Number);
      const points = byName.get(line.dataset.name) || [];
      for (let i = 0; i + 1 < n.length; i += 2) points.push([n[i] / 1000, value(n[i + 1])]);
      byName.set(line.dataset.name, points);
    }
    plot.read = byName;
    return byName;
  };
  const digits = (v) => (Math.abs(v) >= 100 ? v.toFixed(0) : Math.abs(v) >= 10 ? v.toFixed(1) : v.toFixed(2));
  const readout = (plot, part) => {
    const lines = [`${digits(plot.x0 + part * (plot.x1 - plot.x0))} ${plot.svg.dataset.kind === "xy" ? "" : "s"}`];
    for (const [name, points] of series(plot)) {
      let best = null;
      for (const p of points) if (!best || Math.abs(p[0] - part) < Math.abs(best[0] - part)) best = p;
      if (best && Math.abs(best[0] - part) < 0.02) lines.push(`${name}: ${digits(best[1])} ${plot.svg.dataset.unit}`);
    }
    if (plot.svg.dataset.kind === "lanes") {
      for (const lane of plot.svg.querySelectorAll("g[data-name]")) {
        for (const rect of lane.querySelectorAll("rect")) {
          const from = rect.x.baseVal.value / 1000;
          if (from <= part && part < from + rect.width.baseVal.value / 1000) {
            lines.push(`${lane.dataset.name}: ${rect.textContent.replace(/: [^:]*$/, "")}`);
            break;
          }
        }
      }
    }
    return lines.join("\n");
  };
  const clear = () => document.querySelectorAll(".cursor,.readout").forEach((e) => e.remove());
  const point = (at, event) => {
    clear();
    const box = at.svg.getBoundingClientRect();
    const part = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
    const x = at.x0 + part * (at.x1 - at.x0);
    const flight = (p) => p.svg.dataset.kind === "time" || p.svg.dataset.kind === "lanes";
    for (const plot of plots) {
      if (plot !== at && !(flight(plot) && flight(at) && plot.section === at.section)) continue;
      const there = (x - plot.x0) / (plot.x1 - plot.x0);
      if (there < 0 || there > 1) continue;
      const line = document.createElementNS("http://www.w3.org/2000/svg", "path");
      line.setAttribute("class", "cursor");
      line.setAttribute("d", `M${1000 * there} 0v${plot.svg.viewBox.baseVal.height}`);
      plot.svg.append(line);
      if (plot !== at) continue;
      const text = document.createElement("div");
      text.className = there < 0.5 ? "readout right" : "readout";
      text.textContent = readout(plot, there);
      plot.svg.parentElement.append(text);
    }
  };
  for (const plot of plots) {
    plot.svg.addEventListener("pointermove", (event) => point(plot, event));
    plot.svg.addEventListener("pointerleave", clear);
  }
})();
