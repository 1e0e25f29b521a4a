"use strict";
// Plots one after the other, so that the first is there at once and the page stays usable.
const dark = matchMedia("(prefers-color-scheme: dark)");
const views = [];
const places = new Map();
let linking = false;

function colours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(name).trim();
  return { text: of("--text"), soft: of("--soft"), line: of("--line"), ground: of("--ground") };
}

function paint(model) {
  const { text, soft, line } = colours();
  for (const part of model.references()) {
    const kind = part.type;
    if (kind.endsWith("Axis")) {
      part.axis_label_text_color = soft;
      part.major_label_text_color = text;
      if (part.axis_line_color !== null) part.axis_line_color = line;
      if (part.major_tick_line_color !== null) part.major_tick_line_color = line;
    } else if (kind === "Grid" && part.grid_line_color !== null) {
      part.grid_line_color = line;
    } else if (kind === "Legend") {
      part.label_text_color = text;
      part.inactive_fill_color = colours().ground;
    } else if (kind === "ColorBar") {
      part.major_label_text_color = text;
      part.title_text_color = soft;
      part.major_tick_line_color = null;
    }
  }
}

const isOverTime = (model) => model.tags.includes("time");
// What is folded has no size, and is drawn when it is opened.
const isAway = (each) => each.closest("[hidden], details:not([open])") !== null;
const isHidden = (model) => isAway(places.get(model));
let time = null; // What is zoomed to.
const copyTime = () => { if (time) views.filter((model) => isOverTime(model) && !isHidden(model)).forEach((model) => model.x_range.setv(time)); };

function link(model) {
  if (!isOverTime(model)) return;
  if (time) model.x_range.setv(time);
  const follow = () => {
    if (linking) return;
    linking = true;
    time = { start: model.x_range.start, end: model.x_range.end };
    copyTime();
    linking = false;
  };
  model.x_range.properties.start.change.connect(follow);
  model.x_range.properties.end.change.connect(follow);
}

// A finger over a plot scrolls the page.
function leaveTouchAlone(model) {
  if (!matchMedia("(pointer: coarse)").matches) return;
  for (const tool of model.toolbar.tools) if (/Zoom|Pan/.test(tool.type)) tool.active = false;
}

// As many columns of a legend as there is room for; more rows make the figure higher, not its curves lower.
function fitLegend(model) {
  const legend = model.below.find((each) => each.type === "Legend");
  if (!legend) return;
  const longest = Math.max(...legend.items.map((item) => (item.label.value ?? "").length));
  const room = places.get(model).clientWidth - 70;
  const columns = Math.max(1, Math.min(6, Math.floor(room / (7 * longest + 36))));
  const rows = (n) => Math.ceil(legend.items.length / n);
  const height = model.height + 22 * (rows(columns) - rows(legend.ncols));
  if (columns !== legend.ncols) { legend.ncols = columns; model.height = height; }
}

async function show(data) {
  const target = document.getElementById(data.dataset.for);
  const shown = await Bokeh.embed.embed_item(JSON.parse(data.textContent), target);
  const model = shown.roots[0].model;
  places.set(model, target);
  paint(model);
  link(model);
  fitLegend(model);
  leaveTouchAlone(model);
  views.push(model);
  target.style.minHeight = "";
  target.dataset.shown = "yes";
  if (views.length === 1) requestAnimationFrame(() => performance.mark("first plot"));
}

// Those that are neither hidden with a person nor folded, in the order of the page.
const due = () => [...document.querySelectorAll("script.plot-data")].find((data) => {
  const { dataset, parentElement } = document.getElementById(data.dataset.for);
  return !dataset.shown && !isAway(parentElement);
});

let drawing = null;
const showAll = () => (drawing ??= showDue().finally(() => (drawing = null)));

async function showDue() {
  delete document.documentElement.dataset.plots;
  for (let data = due(); data; data = due()) {
    await show(data);
    await new Promise((resolve) => setTimeout(resolve));
  }
  document.documentElement.dataset.plots = String(views.length);
}

function choose(person) {
  // What is read stays where it is on the screen.
  const read = [...document.querySelectorAll("section")].find((each) => each.getBoundingClientRect().bottom > 60);
  const top = read?.getBoundingClientRect().top ?? 0;
  for (const each of document.querySelectorAll(".of-person")) each.hidden = each.dataset.person !== person;
  copyTime();
  document.getElementById("printed").textContent = person;
  if (read) scrollBy({ top: read.getBoundingClientRect().top - top, behavior: "instant" });
  showAll();
}

const collator = new Intl.Collator(undefined, { numeric: true });

function sortable(table) {
  const headings = [...table.tHead.rows[0].cells];
  const keyOf = (cell) => {
    const text = cell.dataset.key ?? cell.textContent;
    return { text, value: Number(text.replace("inf", "Infinity")) };
  };
  const compare = ({ key: a }, { key: b }) =>
    Number.isNaN(a.value) || Number.isNaN(b.value) ? collator.compare(a.text, b.text) : a.value === b.value ? 0 : a.value - b.value;
  headings.forEach((heading, column) => {
    heading.querySelector("button").addEventListener("click", () => {
      const falling = heading.getAttribute("aria-sort") !== "descending";
      for (const each of headings) each.removeAttribute("aria-sort");
      heading.setAttribute("aria-sort", falling ? "descending" : "ascending");
      const rows = [...table.tBodies[0].rows].map((row) => ({ row, key: keyOf(row.cells[column]) })).sort(compare);
      table.tBodies[0].append(...(falling ? rows.reverse() : rows).map(({ row }) => row));
    });
  });
}

function filters(input) {
  const table = document.getElementById(input.dataset.filters);
  const count = document.querySelector(`output[for="${input.dataset.filters}"]`);
  input.addEventListener("input", () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    let left = 0;
    for (const row of table.tBodies[0].rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
      left += row.hidden ? 0 : 1;
    }
    count.textContent = words.length ? `${left} of ${table.tBodies[0].rows.length}` : "";
  });
}

// Canvases do not follow the width of the paper: they are scaled to it.
function toPaper() {
  for (const plot of document.querySelectorAll(".plot")) {
    const isHalf = plot.parentElement.classList.contains("half");
    const width = document.body.classList.contains("study") ? PAPER.wide : isHalf ? PAPER.half : PAPER.whole;
    if (plot.clientWidth) plot.style.setProperty("--zoom", Math.min(width / plot.clientWidth, 1));
  }
  // A plot that was never opened could not be drawn in time.
  for (const each of document.querySelectorAll("details")) each.open ||= !each.querySelector(".plot:not([data-shown])");
}
const PAPER = { wide: 1016, whole: 687, half: 328 }; // Pixels between the margins of A4, as in page.css.

// Drawn anew for the paper, so that its text is as large as that of the page.
async function print() {
  const { classList } = document.documentElement;
  for (const each of document.querySelectorAll("details")) each.open = true;
  await showAll();
  for (const isPaper of [true, false]) {
    classList.toggle("paper", isPaper);
    paintAll();
    views.forEach(fitLegend);
    if (!isPaper) return;
    await new Promise((resolve) => setTimeout(resolve, 500));
    window.print();
  }
}

function paintAll() {
  views.forEach(paint);
  document.documentElement.dataset.painted = dark.matches && !document.documentElement.classList.contains("paper") ? "dark" : "light";
}

addEventListener("beforeprint", toPaper);
addEventListener("resize", () => views.filter((model) => !isHidden(model)).forEach(fitLegend));
document.getElementById("print").addEventListener("click", print);
dark.addEventListener("change", paintAll);
document.querySelectorAll("table.sortable").forEach(sortable);
document.querySelectorAll("input[data-filters]").forEach(filters);
for (const each of document.querySelectorAll("details")) each.addEventListener("toggle", () => { copyTime(); showAll(); });
document.getElementById("person")?.addEventListener("change", (event) => choose(event.target.value));
// What is wider than the screen can be scrolled with the keyboard.
for (const each of document.querySelectorAll(".scroll, nav")) if (each.scrollWidth > each.clientWidth) each.tabIndex = 0;
paintAll();
showAll();
