// The robot on the floor from above, to scale: x to the right, y up, path by its wheels.

// Points of the path closer together are left out, m.
const APART_M = 0.01;
// Of a longer path every second point is left out.
const MOST_POINTS = 4000;
// The view is never narrower, m: a robot that stands still is seen as a whole.
const LEAST_VIEW_M = 1.6;

class Floor {
  constructor(canvas, shape) {
    this.canvas = canvas;
    this.shape = shape;
    this.path = [];
    this.place = null;
  }

  add(place) {
    this.place = place;
    const last = this.path.at(-1);
    if (last && Math.hypot(place.x_m - last[0], place.y_m - last[1]) < APART_M) return;
    this.path.push([place.x_m, place.y_m]);
    if (this.path.length > MOST_POINTS) this.path = this.path.filter((_, at) => at % 2 === 0);
  }

  // From the body's frame to the floor's.
  onFloor([x, y]) {
    const [sin, cos] = [Math.sin(this.place.yaw_rad), Math.cos(this.place.yaw_rad)];
    return [this.place.x_m + x * cos - y * sin, this.place.y_m + x * sin + y * cos];
  }

  outline() {
    const { outline_m: outline, track_m: track } = this.shape;
    if (outline.length) return outline;
    // No outline is known: a square as wide as the wheels are apart.
    const half = track / 2;
    return [[half, -half], [half, half], [-half, half], [-half, -half]];
  }

  draw() {
    const { context, width, height } = prepare(this.canvas);
    if (!this.place || width === 0) return;
    const corners = this.outline().map((corner) => this.onFloor(corner));
    const seen = [...this.path, ...corners, [0, 0]];
    const [xs, ys] = [seen.map(([x]) => x), seen.map(([, y]) => y)];
    const [minX, maxX, minY, maxY] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const margin = 26;
    const scale = Math.min(
      (width - 2 * margin) / Math.max(maxX - minX, LEAST_VIEW_M),
      (height - 2 * margin) / Math.max(maxY - minY, LEAST_VIEW_M / 2),
    );
    const x = (value) => width / 2 + (value - (minX + maxX) / 2) * scale;
    const y = (value) => height / 2 - (value - (minY + maxY) / 2) * scale;
    this.grid(context, width, height, scale, x, y);

    const line = (points, isClosed) => {
      context.beginPath();
      points.forEach(([px, py], at) => (at ? context.lineTo(x(px), y(py)) : context.moveTo(x(px), y(py))));
      if (isClosed) context.closePath();
    };
    context.lineJoin = "round";
    context.strokeStyle = css("--c0");
    context.lineWidth = 2;
    line([...this.path, [this.place.x_m, this.place.y_m]]);
    context.stroke();

    // Where it began.
    context.strokeStyle = css("--muted");
    context.lineWidth = 1.5;
    context.beginPath();
    for (const [dx, dy] of [[6, 0], [0, 6]]) {
      context.moveTo(x(0) - dx, y(0) - dy);
      context.lineTo(x(0) + dx, y(0) + dy);
    }
    context.stroke();

    context.strokeStyle = css("--c1");
    context.fillStyle = css("--c1");
    for (const [fromX, fromY, toX, toY] of this.place.rays_m) {
      const [from, to] = [this.onFloor([fromX, fromY]), this.onFloor([toX, toY])];
      context.setLineDash([4, 4]);
      line([from, to]);
      context.stroke();
      context.setLineDash([]);
      context.beginPath();
      context.arc(x(to[0]), y(to[1]), 3.5, 0, 2 * Math.PI);
      context.fill();
    }

    context.fillStyle = css("--chip");
    context.strokeStyle = css("--ink");
    context.lineWidth = 2;
    line(corners, true);
    context.fill();
    context.stroke();
    // Which way is forwards.
    const reach = Math.max(...this.outline().map(([px]) => px));
    const [nose, tail] = [this.onFloor([reach * 0.8, 0]), this.onFloor([-reach * 0.5, 0])];
    const wings = [this.onFloor([reach * 0.35, reach * 0.35]), this.onFloor([reach * 0.35, -reach * 0.35])];
    line([tail, nose]);
    context.stroke();
    line([wings[0], nose, wings[1]]);
    context.stroke();
  }

  grid(context, width, height, scale, x, y) {
    const step = niceStep(width / scale, Math.max(3, Math.floor(width / 70)));
    context.strokeStyle = css("--grid");
    context.lineWidth = 1;
    context.beginPath();
    const first = (at, zero) => Math.floor((at - zero) / (step * scale));
    for (let n = first(0, x(0)); x(n * step) < width; n++) {
      const at = Math.round(x(n * step)) + 0.5;
      context.moveTo(at, 0);
      context.lineTo(at, height);
    }
    for (let n = first(0, height - y(0)); y(n * step) > 0; n++) {
      const at = Math.round(y(n * step)) + 0.5;
      context.moveTo(0, at);
      context.lineTo(width, at);
    }
    context.stroke();
    // The scale, as long as a step of the grid.
    const [left, bottom, length] = [12, height - 12, step * scale];
    const words = step < 1 ? `${Math.round(step * 100)} cm` : `${step} m`;
    context.fillStyle = css("--card");
    context.fillRect(left - 6, bottom - 24, Math.max(length, context.measureText(words).width) + 12, 30);
    context.strokeStyle = context.fillStyle = css("--ink");
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(left, bottom - 5);
    context.lineTo(left, bottom);
    context.lineTo(left + length, bottom);
    context.lineTo(left + length, bottom - 5);
    context.stroke();
    context.textAlign = "left";
    context.textBaseline = "alphabetic";
    context.fillText(words, left, bottom - 9);
  }
}
