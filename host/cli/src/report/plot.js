// Cursor and zoom for the plots of this page. Without scripts the page shows the same plots, at rest.
//
// Each plot carries its geometry as JSON in `data-plot`, in the units of its viewBox:
// { left, right, foot, span: [first, last], panels: [{ top, bottom, low, high, lines: [{ label, color }] }] }
// Values under the cursor are read off the drawn lines: extremes of short spans where a series is long.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const plots = [...document.querySelectorAll("svg[data-plot]")].map(prepare);

  function element(parent, name, attributes) {
    const made = document.createElementNS(SVG, name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    return parent.appendChild(made);
  }

  function points(line) {
    return line.getAttribute("points").trim().split(/\s+/).map((pair) => pair.split(",").map(Number));
  }

  // Sorts the drawn elements: those that move with the axis (lines, trips, bands), ticks, which are redrawn, and fixed ones.
  function prepare(svg, index) {
    const plot = JSON.parse(svg.dataset.plot);
    Object.assign(plot, { svg, shown: plot.span, lines: [], bands: [], ticks: [], made: [] });
    const [top, bottom] = [plot.panels[0].top, plot.panels.at(-1).bottom];
    const moves = (node) => node.setAttribute("clip-path", `url(#axis${index})`);
    for (const node of svg.querySelectorAll("polyline")) {
      const at = points(node);
      const panel = plot.panels.find((panel) => at.every(([x, y]) =>
        x >= plot.left - 1 && x <= plot.right + 1 && y >= panel.top - 1 && y <= panel.bottom + 1));
      const level = at.length === 2 && at[0][1] === at[1][1] && at[0][0] <= plot.left && at[1][0] >= plot.right;
      if (!panel || level) continue;
      if (at.length === 2 && at[0][0] === at[1][0] && node.getAttribute("stroke") === plot.grid) {
        plot.ticks.push(node);
      } else {
        const series = panel.lines.find((line) => line.color === node.getAttribute("stroke"));
        plot.lines.push({ node, at, panel, series });
        moves(node);
      }
    }
    for (const node of svg.querySelectorAll("rect")) {
      const [x, y, width] = ["x", "y", "width"].map((name) => Number(node.getAttribute(name)));
      if (y < top && x >= plot.left - 1 && node.getAttribute("fill") !== "none") {
        plot.bands.push({ node, x, width });
        moves(node);
      }
    }
    for (const node of svg.querySelectorAll("text")) {
      const [x, y] = ["x", "y"].map((name) => Number(node.getAttribute(name)));
      if (y > bottom && y < plot.foot) plot.ticks.push(node);
      if (y > plot.bandsTop && y < plot.bandsBottom) {
        plot.bands.push({ node, x, width: 0 });
        moves(node);
      }
    }
    // Made last: it is a rectangle too.
    const clip = element(element(svg, "defs", {}), "clipPath", { id: `axis${index}` });
    element(clip, "rect", { x: plot.left, y: 0, width: plot.right - plot.left, height: plot.foot });
    const first = element(svg, "g", { class: "cursor", visibility: "hidden" });
    plot.cursor = element(first, "line", { y1: top, y2: bottom });
    plot.drag = element(first, "rect", { y: top, height: bottom - top, width: 0, class: "drag" });
    plot.reading = document.createElement("p");
    plot.reading.className = "reading";
    plot.group = first;
    svg.closest("figure").append(plot.reading);
    rest(plot);
    listen(plot);
    return plot;
  }

  function rest(plot) {
    plot.group.setAttribute("visibility", "hidden");
    plot.reading.textContent = plot.shown === plot.span
      ? "Point at a plot to read it; drag to zoom."
      : "Drag to zoom further; double-click for all of it.";
  }

  const time = (plot, x) =>
    plot.shown[0] + ((x - plot.left) / (plot.right - plot.left)) * (plot.shown[1] - plot.shown[0]);
  const place = (plot, at) =>
    plot.left + ((at - plot.shown[0]) / (plot.shown[1] - plot.shown[0])) * (plot.right - plot.left);
  // Maps a drawn position to its position on the present axis.
  function moved(plot, x) {
    const whole = plot.span[1] - plot.span[0];
    return place(plot, plot.span[0] + ((x - plot.left) / (plot.right - plot.left)) * whole);
  }

  function decimals(span) {
    return Math.max(0, Math.min(6, 3 - Math.floor(Math.log10(span))));
  }

  function zoom(plot, span) {
    plot.shown = span;
    for (const { node, at } of plot.lines) {
      node.setAttribute("points", at.map(([x, y]) => `${moved(plot, x).toFixed(1)},${y}`).join(" "));
    }
    for (const { node, x, width } of plot.bands) {
      node.setAttribute("x", moved(plot, x));
      if (width) node.setAttribute("width", moved(plot, x + width) - moved(plot, x));
    }
    const all = span === plot.span;
    for (const node of plot.ticks) node.setAttribute("visibility", all ? "visible" : "hidden");
    for (const node of plot.made) node.remove();
    plot.made = [];
    if (!all) ticks(plot);
  }

  function ticks(plot) {
    const rough = (plot.shown[1] - plot.shown[0]) / 8;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((times) => times * power).find((step) => step >= rough);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const label = plot.ticks.find((node) => node.tagName === "text");
    for (let at = Math.ceil(plot.shown[0] / step) * step; at <= plot.shown[1]; at += step) {
      const x = place(plot, at);
      for (const panel of plot.panels) {
        const line = element(plot.svg, "polyline", {
          points: `${x},${panel.top} ${x},${panel.bottom}`, fill: "none", stroke: plot.grid, "stroke-width": 4,
        });
        plot.svg.insertBefore(line, plot.svg.firstChild);
        plot.made.push(line);
      }
      if (label) {
        const text = plot.svg.appendChild(label.cloneNode());
        text.setAttribute("x", x);
        text.setAttribute("visibility", "visible");
        text.textContent = at.toFixed(digits).replace("-", "\u2212");
        plot.made.push(text);
      }
    }
  }

  // Interpolates a series at a time between the two drawn points around it; undefined in a gap.
  function value(plot, line, series, at) {
    const whole = plot.span[1] - plot.span[0];
    const x = plot.left + ((at - plot.span[0]) / whole) * (plot.right - plot.left);
    for (const part of plot.lines.filter((part) => part.panel === line && part.series === series)) {
      const after = part.at.findIndex((point) => point[0] >= x);
      if (after < 0 || (after === 0 && part.at[0][0] > x)) continue;
      const [one, two] = [part.at[Math.max(0, after - 1)], part.at[after]];
      const share = two[0] > one[0] ? (x - one[0]) / (two[0] - one[0]) : 0;
      const y = one[1] + share * (two[1] - one[1]);
      return line.low + ((line.bottom - y) / (line.bottom - line.top)) * (line.high - line.low);
    }
    return undefined;
  }

  function point(plot, x) {
    const at = time(plot, x);
    plot.group.setAttribute("visibility", "visible");
    for (const end of ["x1", "x2"]) plot.cursor.setAttribute(end, x);
    const read = plot.panels.map((panel) => {
      const values = panel.lines.map((line) => {
        const found = value(plot, panel, line, at);
        const digits = decimals(panel.high - panel.low);
        return `${line.label} ${found === undefined ? "\u2013" : found.toFixed(digits).replace("-", "\u2212")}`;
      });
      return `${panel.title}: ${values.join(", ")}`;
    });
    plot.reading.textContent = [`${plot.axis} ${at.toFixed(decimals(plot.shown[1] - plot.shown[0]))}`, ...read]
      .join(" \u00b7 ");
  }

  function listen(plot) {
    const x = (event) => {
      const box = plot.svg.getBoundingClientRect();
      const at = ((event.clientX - box.left) / box.width) * plot.svg.viewBox.baseVal.width;
      return Math.min(plot.right, Math.max(plot.left, at));
    };
    // Plots of the same run share their axis: zooming one zooms all.
    const together = () => plots.filter((other) => String(other.span) === String(plot.span));
    let from;
    plot.svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch") return;
      from = x(event);
      plot.svg.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    plot.svg.addEventListener("pointermove", (event) => {
      const to = x(event);
      const at = time(plot, to);
      for (const other of together()) point(other, place(other, at));
      plot.drag.setAttribute("x", from === undefined ? to : Math.min(from, to));
      plot.drag.setAttribute("width", from === undefined ? 0 : Math.abs(to - from));
    });
    plot.svg.addEventListener("pointerup", (event) => {
      const ends = [from, x(event)];
      from = undefined;
      plot.drag.setAttribute("width", 0);
      if (ends[0] === undefined || Math.abs(ends[1] - ends[0]) < (plot.right - plot.left) / 200) return;
      const span = ends.map((end) => time(plot, end)).sort((one, two) => one - two);
      for (const other of together()) zoom(other, span);
    });
    plot.svg.addEventListener("dblclick", () => {
      for (const other of together()) zoom(other, other.span);
    });
    plot.svg.addEventListener("pointerleave", () => together().forEach(rest));
  }
})();
