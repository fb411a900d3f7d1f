"use strict";
(() => {
  const PAGE = 50, LEAST_SPAN = 0.005, SVG = "http://www.w3.org/2000/svg";
  const $ = (id) => document.getElementById(id);
  const list = document.querySelector("#list tbody");
  const data = JSON.parse($("data").textContent);
  let order = [], first = 0, open = null;

  // --- Data: columns of numbers, and of places in a pool of values ---------------------------------------------------

  data.shared = new Set(data.episodes.shared);
  data.byIndex = new Map(data.episodes.columns.index.map((index, row) => [index, row]));

  function get(name, row) {
    const value = data.episodes.columns[name][row];
    return data.shared.has(name) ? data.episodes.values[value] : value;
  }

  const media = (row) => data.media[get("index", row)] || {};

  function marks(row) {
    const has = media(row);
    return [has.film && "film", has.curves && "curves"].filter(Boolean);
  }

  // --- Elements ------------------------------------------------------------------------------------------------------

  function el(tag, attributes, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes || {})) {
      if (name in made && name !== "list") made[name] = value;
      else made.setAttribute(name, value);
    }
    made.append(...children.filter((child) => child !== null && child !== undefined));
    return made;
  }

  function svg(tag, attributes) {
    const made = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    return made;
  }

  const said = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1"));

  // --- List ----------------------------------------------------------------------------------------------------------

  function options() {
    for (const name of ["task", "setting", "outcome"]) {
      const known = [...new Set(data.episodes.columns[name])].map((place) => data.episodes.values[place]);
      $(name).append(...known.map((value) => el("option", { value, textContent: value })));
    }
  }

  function matches(row) {
    for (const name of ["task", "setting", "outcome"]) {
      if ($(name).value && get(name, row) !== $(name).value) return false;
    }
    if ($("media").value && !marks(row).includes($("media").value)) return false;
    const search = $("search").value.trim().toLowerCase();
    if (!search) return true;
    if (/^\d+$/.test(search)) return get("seed", row) === Number(search) || get("index", row) === Number(search);
    return ["error", "instruction", "end_reason", "worker"].some((name) => (get(name, row) || "").toLowerCase().includes(search));
  }

  function filter() {
    order = data.episodes.columns.index.map((_, row) => row).filter(matches);
    first = Math.min(first, Math.max(0, order.length - 1));
    first -= first % PAGE;
    draw();
  }

  function draw() {
    list.replaceChildren();
    for (const row of order.slice(first, first + PAGE)) {
      list.append(line(row));
      if (get("index", row) === open) list.append(detail(row));
    }
    const last = Math.min(first + PAGE, order.length);
    $("place").textContent = order.length ? `${first + 1} to ${last} of ${order.length}` : "no episode matches";
    $("previous").disabled = first === 0;
    $("next").disabled = last >= order.length;
  }

  function line(row) {
    const index = get("index", row), outcome = get("outcome", row);
    const cells = [
      el("td", { className: "number soft wide", textContent: index }),
      el("td", {}, get("task", row), el("span", { className: "soft small", textContent: ` ${marks(row).join(", ")}` })),
      el("td", { textContent: get("setting", row) }),
      el("td", { className: "number", textContent: get("seed", row) }),
      el("td", {}, el("span", { className: `key ${outcome.replace(" ", "-")}`, textContent: outcome })),
      el("td", { className: "number wide", textContent: said(get("score", row), 2) }),
      el("td", { className: "number wide", textContent: get("steps", row) ?? "–" }),
      el("td", { className: "number wide", textContent: said(get("seconds", row), 1) }),
      el("td", { className: "number wide", textContent: said(get("ms", row), 1) }),
      el("td", { className: "wide soft", textContent: get("end_reason", row) || "" }),
    ];
    const made = el("tr", { className: index === open ? "episode open" : "episode", id: `episode-${index}`, tabIndex: 0 }, ...cells);
    made.setAttribute("aria-expanded", String(index === open));
    made.addEventListener("click", () => toggle(index));
    made.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); toggle(index); $(`episode-${index}`).focus(); }
    });
    return made;
  }

  function toggle(index) {
    open = open === index ? null : index;
    history.replaceState(null, "", open === null ? "#episodes" : `#episode-${open}`);
    draw();
  }

  function reveal(index) {
    if (!data.byIndex.has(index)) return;
    const place = order.indexOf(data.byIndex.get(index));
    if (place < 0) return;
    first = place - (place % PAGE);
    open = index;
    draw();
    $(`episode-${index}`).scrollIntoView();
  }

  // --- One episode ---------------------------------------------------------------------------------------------------

  function detail(row) {
    const has = media(row), pairs = el("dl", { className: "pairs" });
    const add = (name, value, kind) => {
      if (value) pairs.append(el("dt", { textContent: name }), el("dd", { className: kind || "", textContent: value }));
    };
    add("Instruction", get("instruction", row));
    add("Error", get("error", row));
    add("Stages", Object.entries(get("stages", row) || {}).map(([name, done]) => `${name} ${done ? "✓" : "–"}`).join("   "));
    add("Corrected", Object.entries(get("corrections", row) || {}).map(([name, count]) => `${name.replaceAll("_", " ")} in ${count} steps`).join(", "));
    add("Guard", Object.entries(get("safety", row) || {}).map(([name, worst]) => `${name.replaceAll("_", " ")} ${worst.count ?? ""} times`).join(", "));
    const index = String(get("index", row)), earlier = data.episodes.earlier[index] || [];
    add("Earlier attempts", earlier.map((place) => data.episodes.values[place] || "infrastructure error").join("; "));
    add("Steps, time", `${get("steps", row) ?? "–"} steps, ${said(get("seconds", row), 1)} s, ${said(get("ms", row), 1)} ms per request`);
    add("Played by", [get("worker", row), get("server", row)].filter(Boolean).join(", "));
    add("Digest of states", get("digest", row), "mono");
    add("Problem", has.problem);
    const look = el("div", { className: has.film ? "look" : "look blind" });
    if (has.film) look.append(film(has.film));
    look.append(pairs);
    const cell = el("td", { className: "detail", colSpan: 10 }, look);
    if (has.curves) cell.append(curves(has.curves));
    else if (has.trace) cell.append(el("p", { className: "soft small" }, "The curves of this episode are not embedded; they are in ", el("a", { href: has.trace, textContent: has.trace }), "."));
    return el("tr", {}, cell);
  }

  function film(what) {
    if (what.video) return el("video", { src: what.source, controls: true, loop: true, muted: true, playsInline: true });
    const image = el("img", { src: what.source, alt: "film of the episode" });
    image.addEventListener("error", () => image.replaceWith(el("p", { className: "soft small", textContent: `The film is not beside this page: ${what.source}` })));
    return image;
  }

  function decode(text, low, high) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const levels = new DataView(bytes.buffer);
    return Array.from({ length: bytes.length / 2 }, (_, place) => low + ((high - low) * levels.getUint16(2 * place, true)) / 65535);
  }

  function curves(trace) {
    const steps = Math.max(1, ...Object.values(trace.at).map((at) => at.length ? at[at.length - 1] : 0));
    const panels = trace.panels.map((panel) => drawPanel(panel, trace, steps));
    const grid = el("div", { className: "panels" }, ...panels.map((panel) => panel.figure));
    const show = (event) => {
      const box = event.target.closest(".panel svg");
      if (!box) return;
      const frame = box.getBoundingClientRect();
      const step = Math.round(((event.clientX - frame.left) / frame.width) * steps);
      for (const panel of panels) panel.point(Math.min(steps, Math.max(0, step)));
    };
    grid.addEventListener("pointermove", show);
    grid.addEventListener("pointerleave", () => panels.forEach((panel) => panel.point(null)));
    const legend = el("div", { className: "legend" },
      el("span", { className: "s0", textContent: "measured" }), el("span", { className: "s1", textContent: "commanded" }),
      el("span", { className: "borders", textContent: `chunk begins (${trace.chunks.length})` }));
    return el("div", {}, legend, grid);
  }

  function drawPanel(panel, trace, steps) {
    // What hardly moves is drawn as a line in the middle, and not its noise over the whole height.
    const span = Math.max(panel.high - panel.low, LEAST_SPAN), middle = (panel.high + panel.low) / 2;
    const x = (step) => (100 * step) / steps;
    const y = (value) => 50 - (84 * (value - middle)) / span;
    const box = svg("svg", { viewBox: "0 0 100 100", preserveAspectRatio: "none", role: "img", "aria-label": panel.title });
    const opacity = Math.min(0.4, 10 / Math.max(1, trace.chunks.length));
    box.append(svg("path", { class: "chunk", opacity, d: trace.chunks.map((step) => `M${x(step).toFixed(2)} 0V100`).join("") }));
    const values = {};
    for (const source of ["state", "action"]) {
      if (!panel[source]) continue;
      values[source] = decode(panel[source], panel.low, panel.high);
      const at = trace.at[source];
      // A command holds until the next one; a measurement is joined to the next.
      const path = values[source].map((value, place) => {
        const here = `${x(at[place]).toFixed(2)} ${y(value).toFixed(2)}`;
        return place === 0 ? `M${here}` : source === "action" ? `H${x(at[place]).toFixed(2)}V${y(value).toFixed(2)}` : `L${here}`;
      }).join("");
      box.append(svg("path", { class: source, d: path }));
    }
    const cursor = svg("path", { class: "cursor", d: "" });
    box.append(cursor);
    const digits = span < 0.1 ? 3 : 2, range = el("span", { className: "range" });
    const ends = [...new Set([panel.low, panel.high].map((end) => said(end, digits)))];
    const rest = () => (range.textContent = ends.join(" … "));
    rest();
    const point = (step) => {
      cursor.setAttribute("d", step === null ? "" : `M${x(step)} 0V100`);
      if (step === null) return rest();
      const here = Object.entries(values).map(([source, column]) => {
        const at = trace.at[source];
        let place = at.findIndex((one) => one > step);
        place = place < 0 ? at.length - 1 : Math.max(0, place - 1);
        return said(column[place], digits);
      });
      range.textContent = `${(step / trace.frequency).toFixed(2)} s: ${here.join(" / ")}`;
    };
    const caption = el("figcaption", {}, el("span", { textContent: panel.title }), range);
    return { figure: el("figure", { className: "panel" }, caption, box), point };
  }

  // --- Begin -----------------------------------------------------------------------------------------------------------

  options();
  filter();
  for (const name of ["task", "setting", "outcome", "media"]) $(name).addEventListener("change", () => { first = 0; filter(); });
  $("search").addEventListener("input", () => { first = 0; filter(); });
  $("previous").addEventListener("click", () => { first -= PAGE; draw(); });
  $("next").addEventListener("click", () => { first += PAGE; draw(); });
  document.addEventListener("click", (event) => {
    const search = event.target.dataset && event.target.dataset.search;
    if (!search) return;
    $("search").value = search;
    first = 0;
    filter();
    $("episodes").scrollIntoView();
  });
  const wanted = () => { const found = /^#episode-(\d+)$/.exec(location.hash); if (found) reveal(Number(found[1])); };
  addEventListener("hashchange", wanted);
  wanted();
})();
