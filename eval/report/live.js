/* Draws the charts of a page with uPlot: zoom, pan, one cursor for all panels of a chart.
   `eval/report/live.py` writes what is read here. Names, labels and values are set as text only. */
(() => {
"use strict";
const MISSING = 0xffffffff, DEEPER = 4, POINTS = 3000, LEAST_ROWS = 4;
let charts = 0;

async function inflated(text) {
  const packed = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/* A level holds the least and the largest value of each bin of `size` samples from `first` on. */
async function level(piece, chart) {
  const bytes = await inflated(piece.data), total = bytes.length / 4;
  const bins = Math.ceil(piece.rows / piece.size);
  let at = 0;
  const values = line => {
    const scale = Math.pow(10, line.digits), found = new Float64Array(bins);
    for (let bin = 0, whole = line.base; bin < bins; bin++, at++) {
      const word = (bytes[at] | bytes[at + total] << 8 | bytes[at + 2 * total] << 16
        | bytes[at + 3 * total] << 24) >>> 0;
      if (word !== MISSING) whole += (word >>> 1) ^ -(word & 1);
      found[bin] = word === MISSING ? NaN : whole / scale;
    }
    return found;
  };
  const lines = chart.lines.map(line => {
    const low = values(line);
    return {low, high: piece.size > 1 ? values(line) : low};
  });
  return {first: piece.first, last: piece.first + piece.rows - 1, size: piece.size, bins, lines};
}

function coarser(fine) {
  const bins = Math.ceil(fine.bins / DEEPER);
  const joined = (values, sign) => {
    const found = new Float64Array(bins).fill(NaN);
    for (let k = 0; k < values.length; k++) {
      const bin = Math.floor(k / DEEPER);
      if (!(sign * values[k] <= sign * found[bin]) && !isNaN(values[k])) found[bin] = values[k];
    }
    return found;
  };
  const lines = fine.lines.map(line => ({low: joined(line.low, -1), high: joined(line.high, 1)}));
  return {...fine, size: fine.size * DEEPER, bins, lines};
}

async function levels(chart) {
  const found = [];
  for (const piece of chart.pieces) {
    found.push(await level(piece, chart));
    while (found.at(-1).bins > POINTS) found.push(coarser(found.at(-1)));
  }
  return found;
}

/* The finest level that holds all rows from `a` to `b` in few enough bins. */
function chosen(found, a, b) {
  const whole = found.filter(one => one.first <= a && one.last >= b)
    .sort((one, other) => one.size - other.size);
  return whole.find(one => (b - a) / one.size <= POINTS) ?? whole.at(-1);
}

/* Columns of uPlot: times, then per line its samples, or the least and the largest of each bin. */
function columns(chart, one, a, b) {
  const from = Math.max(0, Math.floor((a - one.first) / one.size) - 1);
  const to = Math.min(one.bins - 1, Math.ceil((b - one.first) / one.size) + 1);
  const parts = one.size > 1 ? ["low", "high"] : ["low"];
  const times = [], values = chart.lines.map(() => []);
  for (let bin = from; bin <= to; bin++) parts.forEach((part, k) => {
    times.push(chart.start_s + (one.first + (bin + k / 2) * one.size) * chart.dt_s);
    one.lines.forEach((line, n) => values[n].push(isNaN(line[part][bin]) ? null : line[part][bin]));
  });
  return [times, values];
}

function element(tag, style, text, parent) {
  const made = document.createElement(tag);
  made.className = style;
  made.textContent = text;
  parent.append(made);
  return made;
}

/* Pans with Shift and drag or one finger, zooms with Ctrl and the wheel. */
function moves(view, over) {
  let held = null;
  const seconds = pixels => pixels / over.clientWidth * (view.stop - view.start);
  over.addEventListener("pointerdown", event => {
    if (!event.shiftKey && event.pointerType !== "touch") return;
    held = {x: event.clientX, start: view.start, stop: view.stop};
    over.setPointerCapture(event.pointerId);
  });
  over.addEventListener("pointermove", event => {
    if (!held) return;
    const by = seconds(held.x - event.clientX);
    view.show(held.start + by, held.stop + by);
  });
  over.addEventListener("lostpointercapture", () => { held = null; });
  over.addEventListener("wheel", event => {
    if (!event.ctrlKey) return;
    event.preventDefault();
    const at = view.start + seconds(event.clientX - over.getBoundingClientRect().left);
    view.zoom(event.deltaY > 0 ? 1.25 : 0.8, at);
  }, {passive: false});
}

function shaded(plot, shades) {
  const {left, top, width, height} = plot.bbox;
  plot.ctx.save();
  plot.ctx.beginPath();
  plot.ctx.rect(left, top, width, height);
  plot.ctx.clip();
  for (const [start, stop, colour] of shades) {
    const x = plot.valToPos(start, "x", true);
    plot.ctx.globalAlpha = start === stop ? 0.7 : 0.35;
    plot.ctx.fillStyle = colour;
    plot.ctx.fillRect(x, top, Math.max(1, plot.valToPos(stop, "x", true) - x), height);
  }
  plot.ctx.restore();
}

/* 12:34.7; short without the zeros at its end. */
function elapsed(seconds, decimals, short) {
  const units = Math.round(Math.abs(seconds) * 10 ** decimals), whole = Math.floor(units / 10 ** decimals);
  const hours = Math.floor(whole / 3600), minutes = Math.floor(whole / 60) % 60;
  const two = value => String(value).padStart(2, "0");
  let part = decimals ? "." + String(units % 10 ** decimals).padStart(decimals, "0") : "";
  if (short) part = part.replace(/\.?0+$/, "");
  return (seconds < 0 && units ? "-" : "") + (hours ? `${hours}:${two(minutes)}` : minutes)
    + `:${two(whole % 60)}${part}`;
}

/* What a cursor says of a time: t+12:34.7, and the date and clock where the log has them. */
function moment(chart, time, decimals) {
  if (!chart.elapsed) return time.toFixed(decimals) + " s";
  const text = "t+" + elapsed(time, decimals);
  if (chart.began_s === null) return text;
  const date = new Date(1000 * (chart.began_s + time)).toISOString();
  return `${text} (${date.slice(0, 19).replace("T", " ")} UTC)`;
}

const CLOCK = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300,
  600, 900, 1800, 3600, 7200, 14400, 36000, 86400, 864000];

/* Three numbers or more on an axis of values, however low it is. */
function values(plot, _, low, high, step) {
  while ((high - low) / step < 3) step /= 2;
  const first = Math.ceil(low / step), last = Math.floor(high / step);
  return Array.from({length: last - first + 1}, (_, k) => (first + k) * step);
}

function panel(view, one, last, parent) {
  const {chart} = view, lines = chart.lines.slice(...one.lines);
  const decimals = Math.max(0, Math.min(6, Math.ceil(-Math.log10(chart.dt_s))));
  const numbers = (plot, splits) => splits.map(value => String(+value.toPrecision(10)));
  const times = chart.elapsed ? (_, splits) => splits.map(each => elapsed(each, 3, true)) : numbers;
  const value = line => (plot, _, column, at) => {
    if (at == null) return "";
    const first = view.size > 1 ? at - at % 2 : at, values = plot.data[column];
    return [...new Set(values.slice(first, first + (view.size > 1 ? 2 : 1))
      .map(each => each === null ? "–" : each.toFixed(line.shown)))].join(" to ");
  };
  const font = "11px system-ui, sans-serif";
  const pen = {stroke: "#24292f", font, labelFont: font,
    grid: {stroke: "#e4e8ec", width: 1}, ticks: {show: false}};
  const plot = new uPlot({
    width: parent.clientWidth, height: one.height + (last ? 42 : 6), padding: [6, 8, last ? 0 : 6, 0],
    scales: {x: {time: false}, y: {range: (_, low, high) => {
      const room = 0.05 * (high - low) || 0.01 * Math.abs(high) || 1;
      return low === null ? [0, 1] : [low - room, high + room];
    }}},
    axes: [
      {...pen, size: last ? 24 : 0, values: last ? times : (_, splits) => splits.map(() => ""),
        ...(chart.elapsed && {incrs: CLOCK}),
        ...(last && {label: chart.clock, labelSize: 18})},
      {...pen, size: 52, space: 24, splits: values, values: numbers, label: one.label, labelSize: 16},
    ],
    series: [
      {label: "time", value: (_, time) => time == null ? "" : moment(chart, time, decimals)},
      ...lines.map(line => ({label: line.label, stroke: line.colour, width: line.width,
        dash: line.dash, points: {show: false}, pxAlign: 0, value: value(line)})),
    ],
    bands: one.band ? [{series: [2, 1], fill: lines[0].colour + "2e"}] : [],
    cursor: {
      y: false,
      sync: {key: view.key, setSeries: false, filters: {pub: kind => kind === "mousemove"}},
      drag: {x: true, y: false, setScale: false},
      bind: {
        mousedown: (_, __, handle) => event => event.shiftKey ? null : handle(event),
        dblclick: () => () => view.all(),
      },
    },
    hooks: {
      drawClear: [self => shaded(self, one.shades)],
      setSelect: [self => {
        const {left, width} = self.select;
        if (width > 4) view.show(self.posToVal(left, "x"), self.posToVal(left + width, "x"));
        self.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
      }],
    },
  }, [[], ...lines.map(() => [])], parent);
  moves(view, plot.over);
  return plot;
}

class View {
  constructor(chart, found, root) {
    Object.assign(this, {chart, found, key: `chart-${charts++}`});
    root.role = "group";
    root.ariaLabel = root.parentElement.querySelector("svg").getAttribute("aria-label");
    this.first = chart.start_s;
    this.final = chart.start_s + (chart.rows - 1) * chart.dt_s;
    this.tools(root);
    this.plots = chart.panels.map((one, k) => panel(this, one, k === chart.panels.length - 1, root));
    this.show(...(root.wanted ?? [this.first, this.final]));
    const fit = plot => plot.setSize({width: root.clientWidth, height: plot.height});
    new ResizeObserver(() => this.plots.forEach(fit)).observe(root);
  }

  tools(root) {
    const bar = element("div", "tools", "", root);
    const move = share => {
      const by = share * (this.stop - this.start);
      this.show(this.start + by, this.stop + by);
    };
    for (const [text, says, act] of [
      ["all", "show all", () => this.all()],
      ["+", "zoom in", () => this.zoom(0.5)], ["−", "zoom out", () => this.zoom(2)],
      ["←", "earlier", () => move(-0.5)], ["→", "later", () => move(0.5)],
    ]) {
      const button = element("button", "", text, bar);
      button.title = button.ariaLabel = says;
      button.onclick = act;
    }
    this.note = element("span", "", "", bar);
    if (!this.chart.marks.length) return;
    const list = element("div", "jumps", "", root);
    for (const [start, stop, text, state] of this.chart.marks) {
      element("button", state, text, list).onclick = () => this.show(start, stop);
    }
  }

  all() { this.show(this.first, this.final); }

  zoom(factor, at = (this.start + this.stop) / 2) {
    this.show(at + factor * (this.start - at), at + factor * (this.stop - at));
  }

  /* Show from one time to another, inside of the chart and not less than a few samples. */
  show(start, stop) {
    const {chart} = this, whole = this.final - this.first;
    const length = Math.min(whole, Math.max(stop - start, Math.min(LEAST_ROWS * chart.dt_s, whole)));
    start = Math.min(Math.max(start, this.first), this.final - length);
    [this.start, this.stop] = [start, start + length];
    const row = time => (time - this.first) / chart.dt_s, last = chart.rows - 1;
    const a = Math.max(0, Math.floor(row(start) + 1e-6));
    const b = Math.min(last, Math.ceil(row(this.stop) - 1e-6));
    const one = chosen(this.found, a, b), [times, values] = columns(chart, one, a, b);
    this.size = one.size;
    const bin = `the least and the largest of each ${+(one.size * chart.dt_s).toPrecision(3)} s`;
    this.note.textContent = `${one.size > 1 ? bin : "every sample"}. Drag to zoom, double-click for all, `
      + "Shift and drag to pan, Ctrl and wheel to zoom.";
    this.plots.forEach((plot, k) => plot.batch(() => {
      plot.setData([times, ...values.slice(...chart.panels[k].lines)], false);
      plot.setScale("x", {min: this.start, max: this.stop});
    }));
  }
}

async function draw(root) {
  const chart = JSON.parse(root.dataset.chart), found = await levels(chart);
  root.parentElement.classList.add("on"); // from here on in the place of the SVG
  try {
    root.view = new View(chart, found, root);
  } catch (error) {
    root.parentElement.classList.remove("on");
    throw error;
  }
}

/* A card of an event leads to its log, and there to the event. */
document.querySelectorAll("a[data-show]").forEach(link => link.addEventListener("click", () => {
  const root = document.querySelector(link.getAttribute("href") + " + figure > .live");
  if (!root) return;
  root.wanted = link.dataset.show.split(" ").map(Number);
  root.view?.show(...root.wanted);
}));

const near = new IntersectionObserver(entries => {
  for (const {isIntersecting, target} of entries) {
    if (!isIntersecting) continue;
    near.unobserve(target);
    draw(target.querySelector(":scope > .live"));
  }
}, {rootMargin: "100%"});
document.querySelectorAll(".live").forEach(root => near.observe(root.parentElement));
})();
