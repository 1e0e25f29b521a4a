"use strict";
// Plots one after the other, so that the first is there at once and the page stays usable.
const dark = matchMedia("(prefers-color-scheme: dark)");
const views = [];
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

function link(model) {
  if (!model.tags.includes("time")) return;
  const range = model.x_range;
  const follow = () => {
    if (linking) return;
    linking = true;
    for (const other of views) {
      if (other !== model && other.tags.includes("time")) other.x_range.setv({ start: range.start, end: range.end });
    }
    linking = false;
  };
  range.properties.start.change.connect(follow);
  range.properties.end.change.connect(follow);
}

// A finger over a plot scrolls the page.
function leaveTouchAlone(model) {
  if (!matchMedia("(pointer: coarse)").matches) return;
  for (const tool of model.toolbar.tools) if (/Zoom|Pan/.test(tool.type)) tool.active = false;
}

async function show(data) {
  const target = document.getElementById(data.dataset.for);
  const shown = await Bokeh.embed.embed_item(JSON.parse(data.textContent), target);
  const model = shown.roots[0].model;
  paint(model);
  link(model);
  leaveTouchAlone(model);
  views.push(model);
  target.style.minHeight = "";
  target.dataset.shown = "yes";
  if (views.length === 1) requestAnimationFrame(() => performance.mark("first plot"));
}

async function showAll() {
  for (const data of document.querySelectorAll("script.plot-data")) {
    await show(data);
    await new Promise((resolve) => setTimeout(resolve));
  }
  document.documentElement.dataset.plots = String(views.length);
}

function sortable(table) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    heading.querySelector("button").addEventListener("click", () => {
      const falling = heading.getAttribute("aria-sort") !== "descending";
      for (const each of headings) each.removeAttribute("aria-sort");
      heading.setAttribute("aria-sort", falling ? "descending" : "ascending");
      const key = (row) => row.cells[column].dataset.key ?? row.cells[column].textContent;
      const rows = [...table.tBodies[0].rows].sort((a, b) => {
        const [x, y] = [key(a), key(b)];
        const [p, q] = [Number(x.replace("inf", "Infinity")), Number(y.replace("inf", "Infinity"))];
        return Number.isNaN(p) || Number.isNaN(q) ? x.localeCompare(y, undefined, { numeric: true }) : p === q ? 0 : p - q;
      });
      table.tBodies[0].append(...(falling ? rows.reverse() : rows));
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

dark.addEventListener("change", () => views.forEach(paint));
document.querySelectorAll("table.sortable").forEach(sortable);
document.querySelectorAll("input[data-filters]").forEach(filters);
showAll();
