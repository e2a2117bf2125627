// Strip charts: what some series did in the last seconds, on one canvas for each quantity.
"use strict";

const SPAN_S = 30;
// A pause between two samples that is longer is drawn as one.
const GAP_S = 0.5;

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const colour = (index) => css(`--c${index % 8}`);

// Step of 1, 2 or 5 times a power of ten that divides `span` in at most `most` parts.
function niceStep(span, most) {
  const least = span / most;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * ([1, 2, 5].find((digit) => digit * power >= least * (1 - 1e-9)) ?? 10);
}

const decimalsOf = (step) => Math.max(0, -Math.floor(Math.log10(step) + 1e-9));

// A number with a proper minus, as wide as all others of its decimals.
const text = (value, decimals) => value.toFixed(decimals).replace("-", "\u2212");

// Makes a canvas as fine as the screen. Returns its context with its size in CSS pixels.
function prepare(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = window.devicePixelRatio || 1;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  return { context, width, height };
}

// Lowest and highest value of the series within the span, no narrower than what they resolve.
function bounds(series, nowS) {
  let [low, high] = [Infinity, -Infinity];
  for (const { times, values } of series) {
    for (let at = times.length - 1; at >= 0 && times[at] >= nowS - SPAN_S; at--) {
      if (values[at] === null) continue;
      low = Math.min(low, values[at]);
      high = Math.max(high, values[at]);
    }
  }
  if (low > high) return [0, 1];
  const least = 20 * 10 ** -Math.max(...series.map((one) => one.decimals));
  const middle = (low + high) / 2;
  const half = Math.max(high - low, least) / 2;
  return [middle - half * 1.1, middle + half * 1.1];
}

function drawChart(canvas, series, nowS) {
  const { context, width, height } = prepare(canvas);
  if (width === 0) return;
  const isSwitch = series.every((one) => one.words);
  const [low, high] = isSwitch ? [-0.15, 1.15] : bounds(series, nowS);
  const step = isSwitch ? 1 : niceStep(high - low, Math.max(2, Math.floor(height / 32)));
  const decimals = decimalsOf(step);
  const ticks = [];
  for (let tick = Math.ceil(low / step); tick * step <= high; tick++) ticks.push(tick * step);
  const label = (value) => (isSwitch ? series[0].words[value] : text(value + 0, decimals));
  // At least as wide as most labels, so that the plots of one page begin below one another.
  const left = Math.max(54, ...ticks.map((tick) => Math.ceil(context.measureText(label(tick)).width) + 12));
  const [right, top, bottom] = [width - 10, 8, height - 24];
  const x = (timeS) => right - ((nowS - timeS) / SPAN_S) * (right - left);
  const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);

  context.lineWidth = 1;
  context.strokeStyle = css("--grid");
  context.fillStyle = css("--muted");
  context.textBaseline = "middle";
  context.textAlign = "right";
  context.beginPath();
  for (const tick of ticks) {
    const at = Math.round(y(tick)) + 0.5;
    context.moveTo(left, at);
    context.lineTo(right, at);
    context.fillText(label(tick), left - 7, at);
  }
  context.textAlign = "center";
  context.textBaseline = "top";
  const every = width < 420 ? 10 : 5;
  for (let ago = 0; ago <= SPAN_S; ago += every) {
    const at = Math.round(x(nowS - ago)) + 0.5;
    context.moveTo(at, top);
    context.lineTo(at, bottom);
    if (ago === 0) context.textAlign = "right";
    context.fillText(ago === 0 ? "now" : `\u2212${ago} s`, ago === 0 ? right + 6 : at, bottom + 7);
    context.textAlign = "center";
  }
  context.stroke();

  context.save();
  context.beginPath();
  context.rect(left, top - 4, right - left + 4, bottom - top + 8);
  context.clip();
  context.lineWidth = 1.75;
  context.lineJoin = "round";
  for (const [index, one] of series.entries()) {
    context.strokeStyle = colour(one.colour);
    // Wheels of one side turn alike: a line below is seen through the gaps of the one above it.
    context.setLineDash(index >= 2 ? [9, 7] : []);
    context.beginPath();
    let before = null;
    const { times, values } = one;
    let at = times.length;
    while (at > 0 && times[at - 1] >= nowS - SPAN_S - GAP_S) at--;
    for (; at < times.length; at++) {
      if (values[at] === null) {
        before = null;
        continue;
      }
      const [px, py] = [x(times[at]), y(values[at])];
      if (before === null || times[at] - before > GAP_S) context.moveTo(px, py);
      else context.lineTo(px, py);
      before = times[at];
    }
    context.stroke();
  }
  context.restore();
  context.setLineDash([]);
  context.lineWidth = 1;
  context.strokeStyle = css("--frame");
  context.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
}
