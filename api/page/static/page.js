// What the pages do with scripts: tables that sort and filter, learning curves as they grow, and
// words on what fails. All else is HTML from the server, and works without them.
"use strict";

// Okabe and Ito's colours, in the order of the figures
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f"];
// curves 8 to 14 are dashed, and 15 to 21 dotted; BORDERS has CSS's names, for the legend
const DASHES = [undefined, [8, 4], [2, 3]];
const BORDERS = ["solid", "dashed", "dotted"];
const RETRY_MS = 5000;
const SUBMITTING_MS = 10_000; // for an answer to a form
const sorted = new Map(); // id of a table -> [column, ascending], to survive a refresh
const opened = new Set(); // ids of details that are open, likewise
let focused = null; // before a refresh, which moves the rows of sorted tables
let renewed = new Date();

// the line of a curve whose colour comes again
function inTurn(lines, number) {
  return lines[Math.floor(number / COLOURS.length) % lines.length];
}

function keyOf(row, column) {
  const text = row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
  const number = Number(text.replaceAll(",", ""));
  return text === "" || Number.isNaN(number) ? text : number;
}

function sort(table, column, ascending) {
  const body = table.tBodies[0];
  const compare = (a, b) => {
    const [x, y] = [keyOf(a, column), keyOf(b, column)];
    if (typeof x !== typeof y) return typeof x === "number" ? -1 : 1; // what has no number is last
    const order = typeof x === "number" ? x - y : x.localeCompare(y);
    return ascending ? order : -order;
  };
  body.append(...[...body.rows].sort(compare));
  [...table.tHead.rows[0].cells].forEach((cell, number) => {
    if (number === column) cell.setAttribute("aria-sort", ascending ? "ascending" : "descending");
    else cell.removeAttribute("aria-sort");
  });
  sorted.set(table.id, [column, ascending]);
}

function filter(table) {
  const wanted = [...document.querySelectorAll(`select[data-filters="${table.id}"]`)];
  for (const row of table.tBodies[0].rows) {
    row.hidden = wanted.some((s) => s.value && row.cells[s.dataset.column].textContent.trim() !== s.value);
  }
}

function prepare() {
  for (const table of document.querySelectorAll("table.sortable")) {
    for (const cell of table.tHead.rows[0].cells) {
      if (cell.querySelector("button") || !cell.textContent.trim()) continue;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...cell.childNodes);
      cell.append(button);
    }
    if (sorted.has(table.id)) sort(table, ...sorted.get(table.id));
    filter(table);
  }
  for (const id of opened) document.getElementById(id)?.setAttribute("open", "");
  document.querySelectorAll("[data-scripted]").forEach((each) => (each.hidden = false));
}

document.addEventListener("click", (event) => {
  const cell = event.target.closest("table.sortable th");
  if (!cell || !event.target.closest("button")) return;
  sort(cell.closest("table"), cell.cellIndex, cell.getAttribute("aria-sort") !== "ascending");
});
document.addEventListener("change", (event) => {
  const table = document.getElementById(event.target.dataset?.filters);
  if (table) filter(table);
});
document.addEventListener(
  "toggle",
  ({ target }) => {
    if (target.id && target.open) opened.add(target.id);
    else opened.delete(target.id);
  },
  true,
);
document.addEventListener("htmx:before:swap", () => (focused = document.activeElement));
document.addEventListener("htmx:after:swap", ({ target, detail }) => {
  prepare();
  if (focused?.isConnected && focused !== document.activeElement) focused.focus({ preventScroll: true });
  if (target.id !== "live" || detail.ctx.response.status >= 400) return; // then nothing was swapped
  renewed = new Date();
  tell("stale", "");
});
for (const failure of ["htmx:error", "htmx:response:error"]) {
  document.addEventListener(failure, ({ target, detail }) => {
    if (target.id !== "live") return;
    const status = detail.ctx?.response?.status;
    const answer = status ? `answers ${status}` : "does not answer";
    tell("stale", `As of ${renewed.toLocaleTimeString()}: the service ${answer}.`);
  });
}

// says something at a place of a page that is for it; the same words are not announced again
function tell(id, text) {
  const place = document.getElementById(id);
  if (place && place.textContent !== text) place.textContent = text;
}

// a second click would submit a second time
let submitted = -Infinity;
document.addEventListener("submit", (event) => {
  if (event.target.getAttribute("method") !== "post") return;
  if (Date.now() < submitted + SUBMITTING_MS) event.preventDefault();
  else submitted = Date.now();
});
window.addEventListener("pageshow", () => (submitted = -Infinity)); // also after going back
document.addEventListener("keydown", ({ key }) => {
  if (key === "Escape") submitted = -Infinity; // which stops a browser
});

// a player does not show why it was refused a film
document.addEventListener(
  "error",
  async ({ target }) => {
    if (target.tagName !== "VIDEO") return;
    const answer = await fetch(target.currentSrc, { headers: { Range: "bytes=0-0" } }).catch(() => null);
    const problem = answer?.ok ? null : await answer?.json().catch(() => null);
    const refusal = problem?.detail ?? "the service does not answer";
    tell("refused-film", answer?.ok ? "It did not play: try again, or save it." : `No film: ${refusal}.`);
    target.load(); // it asks again when play is pressed
  },
  true,
);
document.addEventListener("playing", () => tell("refused-film", ""), true);

// Learning curves of a run, from its stream of events, which has the earlier ones too.
function follow(place) {
  const curves = new Map(); // digest of a training -> Map of steps -> return
  let chart = null;
  let isDue = false;

  const short = (number) => Intl.NumberFormat("en", { notation: "compact" }).format(number);

  const size = () => ({ width: Math.min(place.clientWidth, 1000), height: 320 });
  new ResizeObserver(() => chart?.setSize(size())).observe(place);

  function draw() {
    isDue = false;
    const steps = [...new Set([...curves.values()].flatMap((curve) => [...curve.keys()]))];
    steps.sort((a, b) => a - b);
    const values = [...curves.values()].map((curve) => steps.map((at) => curve.get(at) ?? null));
    if (chart && chart.series.length === curves.size + 1) {
      chart.setData([steps, ...values]);
      return;
    }
    chart?.destroy();
    const style = getComputedStyle(document.body);
    const axis = { stroke: style.color, grid: { stroke: "#8884", width: 1 }, ticks: { stroke: "#8884" } };
    const lines = [...curves.keys()].map((digest, number) => ({
      label: `training ${number + 1}`,
      stroke: COLOURS[number % COLOURS.length],
      dash: inTurn(DASHES, number),
      width: 2,
      spanGaps: true,
      points: { show: steps.length < 60 },
      value: (_, value) => (value === null ? "–" : value.toFixed(0)),
    }));
    const options = {
      ...size(),
      scales: { x: { time: false } },
      series: [{ label: "steps" }, ...lines],
      axes: [
        { ...axis, label: "environment steps", space: 70, values: (_, ticks) => ticks.map(short) },
        { ...axis, label: "return on the source", size: 70 },
      ],
      legend: { markers: { dash: (_, series) => inTurn(BORDERS, series - 1) } },
    };
    chart = new uPlot(options, [steps, ...values], place);
  }

  function add(message) {
    const { digest, steps, mean_return: value } = JSON.parse(message.data).event;
    if (!curves.has(digest)) curves.set(digest, new Map());
    curves.get(digest).set(steps, value);
    if (!isDue) {
      isDue = true;
      setTimeout(draw, 100); // many come at once
    }
  }

  let events = null;
  let hasEnded = false;
  let retry = null;
  // a browser has six connections to a service: a page that nobody sees gives its own back
  function connect() {
    events?.close();
    clearTimeout(retry);
    if (document.hidden || hasEnded) return;
    events = new EventSource(place.dataset.stream);
    events.addEventListener("training_evaluated", add);
    events.addEventListener("end", () => {
      hasEnded = true;
      events.close();
    });
    // after an answer that is no stream, as while the service starts, a browser does not ask again
    events.addEventListener("error", (error) => {
      if (error.target.readyState === EventSource.CLOSED) retry = setTimeout(connect, RETRY_MS);
    });
  }
  document.addEventListener("visibilitychange", connect);
  connect();
}

prepare();
const place = document.getElementById("curves");
if (place) follow(place);
