// The page: what the board does, as the program says it 20 times a second, and what its user asks of it.

// Of each series so much is kept, s.
const KEPT_S = 60;
// The program sends a look every 50 ms. Without one for so long the page says so, ms.
const STALE_MS = 500;
// A stop without confirmation for this time is sent once more, by another way, ms.
const CONFIRM_MS = 400;
const AGAIN_MS = 1000;
const MOST_LINES = 8;

const $ = (id) => document.getElementById(id);
const element = (name, properties, ...children) => {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
};

const page = {
  token: document.querySelector("meta[name=r4-token]").content,
  socket: null, board: null, channels: [], series: [], floor: null, look: null, lookAt: 0, beats: null, stopAsked: null,
};

// ---- The link ----

// Whether the program has put its token of this run into the page.
const HAS_OWN_TOKEN = Boolean(page.token);

// The key is behind the # of the address, or was entered; it leaves the address so that it cannot be read there.
if (!page.token) {
  if (location.hash.length > 1) {
    sessionStorage.setItem("r4-token", location.hash.slice(1));
    history.replaceState(null, "", location.pathname);
  }
  page.token = sessionStorage.getItem("r4-token") ?? "";
}

function connect() {
  if (!page.token) return askForKey();
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
  page.socket = socket;
  socket.onopen = () => send({ hello: { token: page.token } });
  socket.onmessage = ({ data }) => receive(JSON.parse(data));
  socket.onclose = () => {
    clearInterval(page.beats);
    page.look = null;
    showState();
    if ($("key").hidden) setTimeout(connect, AGAIN_MS);
  };
}

function send(message) {
  if (page.socket?.readyState !== WebSocket.OPEN) return false;
  page.socket.send(JSON.stringify(message));
  return true;
}

function receive(message) {
  if (message.board) showBoard(message.board);
  else if (message.look) takeLook(message.look);
  else if (message.counters) showCounters(message.counters);
  else if (message.answer) showAnswer(message.answer);
  else if (message.lost) page.lost = message.lost.why;
  else if (message.refused) askForKey(message.refused.why);
}

function askForKey(why) {
  // The program has been started anew since, with another token.
  if (HAS_OWN_TOKEN) return setTimeout(() => location.reload(), AGAIN_MS);
  if (why) $("why").textContent = why;
  sessionStorage.removeItem("r4-token");
  $("key").hidden = false;
  $("token").focus();
}

$("key").onsubmit = (event) => {
  event.preventDefault();
  page.token = $("token").value.trim().replace(/^.*#/, "");
  sessionStorage.setItem("r4-token", page.token);
  $("key").hidden = true;
  connect();
};

// A heartbeat, which says what this page has last seen. A tab that is hidden sends too few to keep the board armed.
function beat() {
  send({ beat: { tick_ms: page.look?.tick_ms ?? 0 } });
}

// ---- What the user asks ----

function say(words, isBad) {
  $("message").textContent = words;
  $("message").toggleAttribute("data-bad", isBad);
}

function ask(what) {
  say(`${what} …`, false);
  if (!send({ ask: what })) say(`${what}: no connection to r4`, true);
}

for (const what of ["arm", "disarm", "clear"]) $(what).onclick = () => ask(what);

// By the socket, and by a request of its own where the socket does not confirm it.
function stop() {
  say("STOP …", true);
  const asked = { isConfirmed: false };
  page.stopAsked = asked;
  if (!send({ ask: "stop" })) return post(asked);
  setTimeout(() => asked.isConfirmed || post(asked), CONFIRM_MS);
}

async function post(asked) {
  let why;
  try {
    const answer = await fetch("/stop", { method: "POST", headers: { "X-R4-Token": page.token }, signal: AbortSignal.timeout(3000) });
    if (answer.ok) return confirmStop(asked);
    why = (await answer.text()).trim();
  } catch {
    why = "r4 does not answer";
  }
  if (!asked.isConfirmed) say(`STOP is not confirmed (${why}): press the stop button on the robot`, true);
}

function confirmStop(asked) {
  if (asked) asked.isConfirmed = true;
  say("stop: done", false);
}

$("stop").onclick = stop;
// Before any button that has the focus: space is the stop here, as in r4 monitor.
for (const name of ["keydown", "keyup"]) {
  window.addEventListener(name, (event) => {
    const isStop = event.key === " " || event.key === "Escape";
    if (!isStop || event.target === $("token")) return;
    event.preventDefault();
    event.stopPropagation();
    if (name === "keydown" && !event.repeat) stop();
  }, true);
}

function showAnswer({ ask: what, error }) {
  if (what === "stop" && !error) return confirmStop(page.stopAsked);
  say(error ? `${what}: ${error}` : `${what}: done`, Boolean(error));
}

// ---- What the board is and does ----

function showBoard(board) {
  const isSame = JSON.stringify(board.channels) === JSON.stringify(page.board?.channels);
  page.board = board;
  page.lost = null;
  $("robot").textContent = board.robot || "unnamed robot";
  $("address").textContent = board.address;
  $("firmware").textContent = `, firmware ${board.firmware}`;
  $("kind").textContent = board.kind;
  $("kind").hidden = false;
  $("timeout").textContent = `${board.link_timeout_ms} ms`;
  document.title = `${board.robot} – R4`;
  if (!isSame) buildChannels(board.channels);
  page.floor = board.shape && new Floor($("map"), board.shape);
  $("floor").hidden = !board.shape;
  clearInterval(page.beats);
  page.beats = setInterval(beat, board.beat_ms);
  say("", false);
}

// Name of what a series shows, without the axis: that of its chart.
const chartOf = ({ channel, name }) => (name === "value" ? channel.replace(/\d+$/, "") : name.replace(/ [xyz]$/, ""));
const lineOf = ({ channel, name }) => channel + (/ [xyz]$/.exec(name)?.[0] ?? "");

function buildChannels(channels) {
  const many = [];
  const single = [];
  page.series = [];
  page.channels = channels.map((channel) => {
    const series = channel.series.map((one) => {
      const made = { ...one, channel: channel.name, times: [], values: [], colour: 0, isShown: false, chip: makeChip(channel, one) };
      made.chip.onclick = () => plot(made, !made.isShown);
      page.series.push(made);
      return made;
    });
    const row = { series, follows: element("p", { className: "follows" }) };
    const chips = series.map((one) => one.chip);
    if (series.length === 1) single.push(...chips);
    else {
      const name = element("div", {}, element("h3", { textContent: channel.name }), row.follows);
      many.push(element("div", { className: "channel" }, name, element("div", { className: "chips" }, ...chips)));
    }
    return row;
  });
  const others = element("div", {}, element("h3", { textContent: "others" }));
  if (single.length) many.push(element("div", { className: "channel" }, others, element("div", { className: "chips" }, ...single)));
  $("rows").replaceChildren(...many);
  chooseFirst();
}

function makeChip(channel, one) {
  const label = channel.series.length === 1 ? channel.name : one.name;
  const chip = element("button", { type: "button", className: "chip", title: `${channel.name} ${one.name}` });
  chip.setAttribute("aria-pressed", "false");
  chip.append(element("small", { textContent: label }), element("span", { textContent: "–" }));
  return chip;
}

// Speeds of motors and what the supplies have, or whatever is there.
function chooseFirst() {
  const speeds = page.series.filter((one) => one.name === "speed").slice(0, MOST_LINES);
  const supplies = page.series.filter((one) => one.unit === "V" || one.unit === "A").slice(0, 1);
  const chosen = [...(speeds.length ? speeds : page.series.slice(0, 2)), ...supplies];
  chosen.forEach((one) => plot(one, true));
}

function plot(one, isShown) {
  one.isShown = isShown;
  one.chip.setAttribute("aria-pressed", String(isShown));
  const others = page.series.filter((other) => other !== one && other.isShown && chartOf(other) === chartOf(one) && other.unit === one.unit);
  const free = [...Array(MOST_LINES).keys()].find((index) => !others.some((other) => other.colour === index));
  one.colour = free ?? 0;
  buildCharts();
}

function buildCharts() {
  const groups = new Map();
  for (const one of page.series.filter((series) => series.isShown)) {
    const key = `${chartOf(one)}${one.unit && `, ${one.unit}`}`;
    groups.set(key, [...(groups.get(key) ?? []), one]);
  }
  page.charts = [...groups].map(([title, series]) => {
    const legend = element("p", { className: "legend" }, element("b", { textContent: title }));
    for (const one of series) {
      const swatch = element("i", {});
      swatch.style.background = `var(--c${one.colour})`;
      legend.append(element("span", {}, swatch, lineOf(one)));
    }
    const canvas = element("canvas", {});
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${title} over the last 30 s`);
    return { series, canvas, node: element("div", { className: "chart" }, legend, canvas) };
  });
  const empty = element("p", { className: "empty", textContent: "Nothing is plotted: tap a value under Channels." });
  $("charts").replaceChildren(...(page.charts.length ? page.charts.map((chart) => chart.node) : [empty]));
  for (const one of page.series) {
    one.chip.querySelector("i")?.remove();
    if (!one.isShown) continue;
    const swatch = element("i", {});
    swatch.style.background = `var(--c${one.colour})`;
    one.chip.querySelector("small").prepend(swatch);
  }
}

// From -180 to 180.
const degrees = (yaw) => (Math.atan2(Math.sin(yaw), Math.cos(yaw)) * 180) / Math.PI;

function takeLook(look) {
  // A board that has started anew has a new time.
  if (look.board_s < (page.look?.board_s ?? 0) - 1) page.series.forEach((one) => { one.times = []; one.values = []; });
  page.look = look;
  page.lookAt = performance.now();
  for (const { at, numbers, fault, is_bad: isBad, follows } of look.values) {
    const row = page.channels[at];
    row.series.forEach((one, index) => {
      keep(one, look.board_s, numbers[index]);
      showValue(one, numbers[index], fault, isBad);
    });
    row.follows.textContent = look.state === "armed" ? (follows ?? "") : "";
  }
  if (look.place && page.floor) {
    page.floor.add(look.place);
    const { x_m: x, y_m: y, yaw_rad: yaw } = look.place;
    $("place").textContent = `x ${text(x, 2)} m, y ${text(y, 2)} m, heading ${text(degrees(yaw), 0)}° (x forwards, y to the left)`;
  }
  showState();
  requestDraw();
}

function keep(one, timeS, value) {
  one.times.push(timeS);
  one.values.push(value);
  if (one.times[0] < timeS - 2 * KEPT_S) {
    const first = one.times.findIndex((time) => time >= timeS - KEPT_S);
    one.times.splice(0, first);
    one.values.splice(0, first);
  }
}

function showValue(one, value, fault, isBad) {
  const span = one.chip.querySelector("span");
  span.classList.toggle("fault", Boolean(fault));
  span.classList.toggle("bad", Boolean(isBad));
  if (fault) span.textContent = fault;
  else if (value === null || value === undefined) span.textContent = "–";
  else if (one.words) span.textContent = one.words[value] ?? value;
  else span.replaceChildren(text(value, one.decimals), element("em", { textContent: one.unit && ` ${one.unit}` }));
}

function showState() {
  const { look } = page;
  const isOld = !look || performance.now() - page.lookAt > STALE_MS;
  const isSilent = !isOld && look.silent_ms > 2 * page.board.link_timeout_ms;
  const state = isOld ? "unknown" : look.state;
  document.body.dataset.state = state;
  $("state").textContent = isOld ? "no link" : state;
  $("next").textContent = isOld ? page.lost ?? "r4 does not answer: it has ended, or looks for its board again" : look.next;
  const items = isOld ? [] : [
    ...look.causes.map(({ cause, advice }) => element("li", {}, element("strong", { textContent: cause }), `: ${advice}`)),
    ...look.hot.map((hot) => element("li", {}, element("strong", { textContent: hot }), ": drive it less, or let it cool; at 100 % the board trips")),
  ];
  const words = items.map((item) => item.textContent).join("\n");
  if ($("causes").dataset.words !== words) {
    $("causes").dataset.words = words;
    $("causes").replaceChildren(...items);
  }
  $("next").hidden = !isOld && look.causes.length > 0;
  const link = isOld ? "no connection to r4: trying again" : isSilent ? `board silent for ${(look.silent_ms / 1000).toFixed(1)} s`
    : look.commands ? `connected; ${look.commands} commands` : "connected; no program commands";
  $("link").textContent = link;
  $("link").dataset.link = isOld || isSilent ? "bad" : "good";
  $("arm").disabled = state !== "disarmed";
  $("disarm").disabled = state !== "armed";
  $("clear").disabled = state !== "tripped";
}

function showCounters(counters) {
  $("counters").replaceChildren(...counters.map(({ name, value, is_bad: isBad }) =>
    element("div", {}, element("dt", { textContent: name }), element("dd", { textContent: value, className: isBad ? "bad" : "" }))));
}

// ---- Drawing ----

function requestDraw() {
  if (page.isDrawing) return;
  page.isDrawing = true;
  requestAnimationFrame(() => {
    page.isDrawing = false;
    const nowS = page.look?.board_s ?? 0;
    for (const { canvas, series } of page.charts ?? []) drawChart(canvas, series, nowS);
    if (page.floor && !$("floor").hidden) page.floor.draw();
  });
}

window.addEventListener("resize", requestDraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", requestDraw);
setInterval(showState, 200);
connect();
