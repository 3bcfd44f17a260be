// Elements of the page in addition to viser's widgets, created by `Channel`: the header, the guide's
// card, the timeline, number boxes that accept a complete number only, and keys.
// `box` is the widget that carries the page's messages to the server; `ranges` has the ranges of the
// number boxes.
window.dbbControls = (box, ranges) => {
  const HEIGHT = 100; // [px] of the bar
  const LANE = 0.34; // [-] share of the lane of β in the height of both lanes; it is the upper one
  const PAST = "#e8890c";
  const POSTURE = "Preview, not simulated";
  const COLOURS = { scenario: "#4c9be8", parameter: "#9775fa", person: "#22b8cf", buffer: "#f0962b",
    limit: "#e05424", contact: "#e21038" };
  const ending = new AbortController();
  const listen = (to, kinds, act, more = {}) => {
    for (const kind of kinds.split(" ")) to.addEventListener(kind, act, { signal: ending.signal, ...more });
  };
  let count = 0;
  const sent = new Map(); // the last values of each message
  const ask = (word, ...values) =>
    window.__viserMutable?.sendMessage({ type: "GuiUpdateMessage", uuid: box,
      updates: { value: JSON.stringify([`${Date.now()}.${count++}`, word, ...values]) } });

  // ---- the bar
  const make = (tag, parent, id, text = "") => {
    const element = parent.appendChild(document.createElement(tag));
    if (id) element.id = id;
    element.textContent = text;
    return element;
  };
  const head = make("header", document.body, "dbb-head");
  const name = make("div", head, "dbb-name");
  name.title = "dbb: distance buffer border, the coloured points around the base";
  make("h1", name, "", "dbb").append(Object.assign(document.createElement("span"), { textContent: " self-collision avoidance" }));
  make("p", name, "", "Moves a robot's base out of the way of its arm");
  const live_ = make("div", head, "dbb-live");
  const card = make("section", document.body, "dbb-card");
  card.setAttribute("aria-label", "Guide");
  const bar = make("footer", document.body, "dbb-bar");
  const edge = make("div", document.body, "dbb-edge");
  const past = make("div", document.body, "dbb-past");
  const hint = make("div", document.body, "dbb-hint");
  const row = make("div", bar, "dbb-row");
  const strip = make("canvas", bar, "dbb-strip");
  const said = make("span", past);
  const button = (parent, text, title, act) => {
    const element = make("button", parent, "", text);
    element.title = title;
    listen(element, "click", (e) => (act(), e.detail && element.blur())); // with a key the focus stays
    return element;
  };
  const back = button(past, "Back to now", "Escape or N", () => ask("now"));
  const pause = button(row, "Pause", "Space", () => ask("pause"));
  const where = make("b", make("span", row));
  button(row, "−1 s", "B", () => ask("step", -1));
  button(row, "−20 ms", "One snapshot back", () => ask("step", -0.02));
  button(row, "+20 ms", "One snapshot forward; from the newest one in a pause, 20 ms of simulation", () => ask("step", 0.02));
  button(row, "+1 s", "F", () => ask("step", 1));
  const play = button(row, "▶ Replay", "Replay from the shown instant; at the newest one, the last 10 s", () => ask("play", Number(rate.value)));
  const rate = make("select", row);
  rate.setAttribute("aria-label", "Replay speed");
  for (const x of [0.1, 0.25, 0.5, 1, 2, 4]) Object.assign(make("option", rate, "", `${x} ×`), { value: x, selected: x === 1 });
  button(row, "Back to now", "N", () => ask("now"));
  button(row, "Nearest", "Go to the instant with the smallest distance", () => ask("nearest"));
  button(row, "Largest pull", "Go to the instant with the largest force", () => ask("pull"));
  button(row, "◂ Event", "Previous event", () => beside(-1));
  button(row, "Event ▸", "Next event", () => beside(1));
  button(row, "Mark start", "Start of the interval to save", () => ask("begin"));
  button(row, "Mark end", "End of the interval to save", () => ask("end"));
  button(row, "Clear marks", "Without marks, the last minute is saved", () => ask("unmark"));
  button(row, "−", "Zoom out: more time (mouse wheel, or two fingers)", () => zoom(2, middle())).setAttribute("aria-label", "Zoom out");
  button(row, "+", "Zoom in: less time (mouse wheel, or two fingers)", () => zoom(0.5, middle())).setAttribute("aria-label", "Zoom in");
  const marked = make("span", bar, "dbb-marked");
  strip.tabIndex = 0;
  strip.setAttribute("role", "slider");
  strip.setAttribute("aria-label", "Timeline");
  edge.hidden = past.hidden = hint.hidden = card.hidden = true;

  // ---- content of the bar
  let kept = 600, bin = 0.1, rows = [], events = new Map();
  let now = 0, at = 0, begin = null, end = null, live = true, paused = false, d_b = 0.15, playing = false, posing = false, earlier = false;
  let span = 30, right = null; // [s] shown interval and its end; null follows the newest time
  const until = () => right ?? Math.max(now, span);
  const from = () => until() - span;
  const middle = () => Math.min(Math.max(at, from()), until());
  const width = () => strip.getBoundingClientRect().width;
  const x = (t) => ((t - from()) / span) * width();
  const time = (px) => from() + (px / width()) * span;
  const zoom = (factor, about) => {
    const share = (about - from()) / span;
    const next = Math.min(Math.max(span * factor, 2), kept);
    const last = about + next * (1 - share);
    right = last >= now - 1e-9 || next >= now ? null : last;
    span = next;
    draw();
  };
  let visited = 0; // [s] event of the last jump; beyond the last 60 s, the shown instant is near it only
  const beside = (way) => {
    const here = now - at > 59 && Math.abs(visited - at) < 0.25 ? visited : at;
    const times = [...events.values()].map((e) => e[1]).filter((t) => (t - here) * way > 0.03);
    if (times.length) ask("go", (visited = way > 0 ? Math.min(...times) : Math.max(...times)));
  };
  const nearest = (e) => { // the event whose mark is under the pointer
    const px = local(e);
    let found = null, off = e.clientY - strip.getBoundingClientRect().top < 14 ? 8 : 0;
    for (const event of events.values()) {
      const away = Math.abs(x(event[1]) - px);
      if (away < off) [found, off] = [event, away];
    }
    return found;
  };
  let due = 0, hovered = null;
  const draw = () => {
    if (!due) due = requestAnimationFrame(() => ((due = 0), paint(), hovered && explain()));
  };
  const theme = new MutationObserver(draw); // the strip's colours are those of the theme
  theme.observe(document.documentElement, { attributeFilter: ["data-mantine-color-scheme"] });
  const paint = () => {
    const dpr = window.devicePixelRatio || 1, w = width(), h = HEIGHT - 31;
    const [W, H] = [Math.round(w * dpr), Math.round(h * dpr)];
    if (strip.width !== W || strip.height !== H) [strip.width, strip.height] = [W, H];
    const ink = strip.getContext("2d");
    ink.setTransform(dpr, 0, 0, dpr, 0, 0);
    ink.clearRect(0, 0, w, h);
    const path = (...points) => {
      ink.beginPath();
      for (const point of points) ink.lineTo(...point);
    };
    const text = getComputedStyle(bar).color, foot = h - 13, head = 12;
    const name = (words, side, left, low) => { // on a background, because curves are below it
      ink.textAlign = side;
      ink.lineWidth = 3;
      ink.strokeStyle = getComputedStyle(bar).backgroundColor;
      ink.strokeText(words, left, low);
      ink.fillText(words, left, low);
      ink.textAlign = "left";
    };
    const full = Math.max(0.3, 1.5 * d_b); // [m] distance that fills its lane
    const lane = LANE * (foot - head); // [px] height of the lane of β
    const y = (d) => foot - Math.min(Math.max(d, 0) / full, 1) * (foot - head - lane);
    if (begin !== null && !earlier) {
      ink.fillStyle = "rgba(38, 132, 214, .25)";
      ink.fillRect(x(begin), 0, Math.max(x(end ?? now) - x(begin), 2), foot);
    }
    marked.style.left = `${Math.max(Math.min(earlier ? 0.4 * w : x(begin ?? 0), w - marked.offsetWidth), 0)}px`;
    const shown = rows.filter(([t]) => t > from() - 1 && t < until() + 1);
    ink.fillStyle = "rgba(142, 107, 216, .55)"; // β, drawn downwards
    shown.forEach(([t, , beta], i) => {
      const end = Math.min(shown[i + 1]?.[0] ?? t + bin, t + 10 * bin); // a busy computer skips snapshots
      const width = x(end) - x(t);
      if (beta > 0) ink.fillRect(x(t), head, Math.max(width, 1), beta * (lane - 2));
    });
    ink.lineWidth = 1.6;
    ink.lineJoin = "round";
    for (let i = 1; i < shown.length; i++) {
      const [t, d, , buffer] = shown[i], [s, c] = shown[i - 1];
      ink.strokeStyle = Math.min(c, d) < 0 ? COLOURS.contact : Math.min(c, d) < buffer ? COLOURS.buffer : "#808a96";
      path([x(s), y(c)], [x(t), y(d)]);
      ink.stroke();
      if (d < 0) {
        ink.fillStyle = COLOURS.contact;
        ink.fillRect(x(t), foot - 3, Math.max(x(t + bin) - x(t), 2), 3);
      }
    }
    ink.strokeStyle = text;
    ink.globalAlpha = 0.4;
    ink.lineWidth = 1;
    ink.setLineDash([4, 4]);
    path(...shown.map(([t, , , buffer]) => [x(t), y(buffer)]), [w, y(shown.at(-1)?.[3] ?? d_b)]);
    ink.moveTo(0, foot);
    ink.lineTo(w, foot);
    ink.stroke();
    ink.setLineDash([]);
    ink.fillStyle = text;
    ink.fillRect(0, head + lane - 1, w, 1);
    ink.globalAlpha = 0.75;
    ink.fillStyle = text;
    ink.font = "10px sans-serif";
    const step = [0.5, 1, 2, 5, 10, 30, 60, 120].find((s) => (s / span) * w > 55) ?? 120;
    for (let t = Math.ceil(Math.max(from(), 0) / step) * step; t <= until(); t += step) {
      ink.fillRect(x(t), foot, 1, 3);
      ink.fillText(`${+t.toFixed(1)} s`, x(t) + 3, h - 2);
    }
    if (w > 500) { // on a phone the names would hide the curves
      name("activation β", "left", 4, head + 9);
      name("nearest distance", "left", 4, foot - 3);
    }
    name(`buffer d_b ${Math.round(1000 * d_b)} mm`, "right", w - 4, y(d_b) + 11);
    ink.globalAlpha = 1;
    for (const [, t, kind] of events.values()) {
      const px = x(t);
      if (px < -5 || px > w + 5) continue;
      ink.fillStyle = COLOURS[kind] ?? text;
      ink.fillRect(px - 0.5, 4, 1, foot - 4);
      ink.beginPath();
      ink.arc(px, 5, 4, 0, 7);
      ink.fill();
    }
    ink.fillStyle = live ? text : PAST;
    ink.fillRect(x(at) - 1, 0, 2, h);
    path([x(at) - 6, 0], [x(at) + 6, 0], [x(at), 8]);
    ink.fill();
  };
  const say = () => {
    const ago = `${(now - at).toFixed(2)} s ago`;
    where.textContent = posing ? POSTURE : `t = ${at.toFixed(2)} s, ${live ? (paused ? "now, paused" : "now") : ago}`;
    said.textContent = posing ? POSTURE : `Viewing the past, ${ago}`;
    back.hidden = posing;
    pause.textContent = paused ? "Continue" : "Pause";
    play.textContent = playing ? "■ Stop" : "▶ Replay";
    edge.hidden = past.hidden = live && !posing;
    const mark = (t) => (t === null ? "…" : t.toFixed(2));
    marked.textContent = begin === null ? "" : `marked ${mark(begin)} to ${mark(end)} s${earlier ? " of the earlier run" : ""}`;
    if (live) right = null;
    else if (at < from() || at > until()) right = Math.min(Math.max(at + span / 2, span), Math.max(now, span));
    for (const [name, value] of Object.entries({ valuemin: 0, valuemax: now, valuenow: at, valuetext: where.textContent }))
      strip.setAttribute(`aria-${name}`, value);
    draw();
  };

  // ---- scrubbing: at most 20 requests per second, each with the newest time
  let wanted = null, waits = 0, pinch = null;
  const fingers = new Map();
  const scrub = (e) => {
    const mark = nearest(e);
    const t = Math.max(mark ? mark[1] : time(local(e)), 0);
    wanted = t >= now - bin ? ["now"] : ["go", t];
    if (!waits) flush();
  };
  const flush = () => {
    if (wanted) ask(...wanted);
    waits = wanted ? setTimeout(flush, 50) : 0;
    wanted = null;
  };
  const local = (e) => e.clientX - strip.getBoundingClientRect().left;
  listen(strip, "pointerdown", (e) => {
    fingers.set(e.pointerId, local(e));
    strip.setPointerCapture(e.pointerId);
    strip.focus({ preventScroll: true });
    if (right === null && !live) right = until();
    if (fingers.size === 1) scrub(e);
    else pinch = null;
  });
  // The text belongs to the instant under the pointer, also while the drawn curves move on.
  const explain = () => {
    const e = hovered, mark = nearest(e), t = time(local(e));
    const there = rows.findLast?.((r) => r[0] <= t);
    hint.textContent = mark ? `${mark[1].toFixed(1)} s: ${mark[3]}`
      : there ? `${t.toFixed(1)} s: smallest distance ${Math.round(1000 * there[1])} mm, activation β ${there[2].toFixed(2)}` : "";
    hint.hidden = !hint.textContent;
    hint.style.left = `${Math.min(Math.max(e.clientX - hint.offsetWidth / 2, 4), innerWidth - hint.offsetWidth - 4)}px`;
  };
  listen(strip, "pointermove", (e) => {
    hovered = e;
    explain();
    if (!fingers.has(e.pointerId)) return;
    fingers.set(e.pointerId, local(e));
    if (fingers.size === 1) return scrub(e);
    const [a, b] = [...fingers.values()], apart = Math.max(Math.abs(a - b), 10);
    if (pinch) zoom(pinch / apart, time((a + b) / 2));
    pinch = apart;
  });
  listen(strip, "pointerup pointercancel", (e) => (fingers.delete(e.pointerId), (pinch = null)));
  listen(strip, "pointerleave", () => ((hovered = null), (hint.hidden = true)));
  listen(strip, "wheel", (e) => {
    e.preventDefault();
    if (Math.abs(e.deltaX) > Math.abs(e.deltaY)) {
      const last = until() + (e.deltaX / width()) * span;
      right = last >= now ? null : Math.max(last, span);
      draw();
    } else zoom(Math.exp(e.deltaY / 400), time(local(e)));
  }, { passive: false });
  const KEYS = { ArrowLeft: [-1, -0.02], ArrowRight: [1, 0.02], PageDown: [-10, -10], PageUp: [10, 10] };
  listen(strip, "keydown", (e) => {
    if (e.key in KEYS) ask("step", KEYS[e.key][e.shiftKey ? 1 : 0]);
    else if (e.key === "Home") ask("go", rows[0]?.[0] ?? 0);
    else if (e.key === "End") ask("now");
    else if ("+-".includes(e.key)) zoom(e.key === "+" ? 0.5 : 2, middle());
    else return;
    e.preventDefault();
    e.stopPropagation();
  });
  listen(window, "resize", draw);

  // ---- number boxes: the server gets the complete number, not each key
  const typed = new Map(); // edited boxes and their previous values
  const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  let passing = false;
  const pass = (input, text) => {
    for (let i = 0; i < 2 && (i === 0 || input.value !== text); i++) {
      set.call(input, text);
      passing = true;
      input.dispatchEvent(new Event("input", { bubbles: true }));
      passing = false;
    }
  };
  const take = (input) => {
    if (!typed.has(input)) return;
    const before = typed.get(input), text = input.value.trim();
    typed.delete(input);
    const value = text === "" ? NaN : Number(text.replace("−", "-").replace(/^([^.]*),([^.]*)$/, "$1.$2"));
    let label = null;
    for (let e = input.parentElement; e && !label; e = e.parentElement) label = e.querySelector("label[for]");
    const [low, high] = ranges[label?.htmlFor] ?? [null, null];
    const fits = Number.isFinite(value) && value >= (low ?? -Infinity) && value <= (high ?? Infinity);
    pass(input, fits ? String(value) : before);
    if (fits) return;
    const range = low === null && high === null ? "" : low === null ? ` up to ${high}` : high === null ? ` from ${low}` : ` from ${low} to ${high}`;
    const name = label?.textContent.replace("•", "").trim() || "this box";
    ask("refused", `${name} needs a number${range}, not ${text ? `“${text.slice(0, 40)}”` : "nothing"}; the value stays ${before}.`);
  };
  const number = (e) => e.target instanceof HTMLInputElement && e.target.closest(".mantine-NumberInput-root");
  listen(window, "focusin", (e) => {
    if (number(e) && !typed.has(e.target)) e.target.dbbBefore = e.target.value;
  }, { capture: true });
  listen(window, "input", (e) => {
    if (passing || !number(e)) return;
    if (!typed.has(e.target)) typed.set(e.target, e.target.dbbBefore ?? "");
    e.stopImmediatePropagation();
  }, { capture: true });
  listen(window, "keydown", (e) => {
    if (number(e) && ["Enter", "ArrowUp", "ArrowDown"].includes(e.key)) {
      take(e.target);
      e.target.dbbBefore = e.target.value;
    } else if (number(e) && e.key === "Escape" && typed.has(e.target)) {
      pass(e.target, typed.get(e.target));
      typed.delete(e.target);
      e.stopImmediatePropagation();
    } else if (e.key === "?" && !e.target.closest("input, textarea")) {
      window.dbbPanels.open("Help");
    } else if (e.key === "Escape") {
      const open = (kinds) => [...document.querySelectorAll(kinds)].some((each) => each.offsetHeight);
      if (open("[role=listbox]")) return;
      const over = !card.hidden || open(".mantine-Modal-content"); // only otherwise does Escape leave the past
      ask("escape");
      if (!over && !live) ask("now");
    }
  }, { capture: true });
  // "change" comes before the box itself converts the text to a number.
  listen(window, "change focusout", (e) => number(e) && take(e.target), { capture: true });
  listen(window, "pointerdown", (e) => {
    for (const input of [...typed.keys()]) if (input !== e.target) take(input);
  }, { capture: true });

  // ---- a list after a choice, and a clicked tab, lose the focus, so that the page's keys work
  listen(window, "click", (e) => {
    if (e.target.closest?.("[role=option]") || (e.detail && e.target.closest?.("[role=tab]"))) document.activeElement?.blur();
  });

  // ---- explanation of a plot's line, under the pointer
  let hints = {};
  listen(window, "pointerover", (e) => {
    const line = e.target.closest?.(".u-legend .u-series"), plot = line?.closest(".uplot");
    if (plot) line.title = hints[plot.querySelector(".u-title").textContent]?.[line.querySelector(".u-label").textContent.trim()] ?? "";
  });

  // ---- while Shift is held, keys pull the end-effector
  const PULLS = { ArrowUp: [1, 0, 0], ArrowDown: [-1, 0, 0], ArrowLeft: [0, 1, 0], ArrowRight: [0, -1, 0],
    PageUp: [0, 0, 1], PageDown: [0, 0, -1] };
  const elsewhere = (e) => e.target.closest?.("input, textarea, [role=slider], [role=tab]");
  listen(window, "keydown", (e) => {
    if (!e.shiftKey || !(e.key in PULLS) || elsewhere(e)) return;
    ask("nudge", ...PULLS[e.key]);
    e.preventDefault();
    e.stopImmediatePropagation();
  }, { capture: true });
  listen(window, "keyup blur", (e) => (e.key === "Shift" || e.type === "blur") && ask("drop"));

  // ---- the pointer over the scene, for the values there: at most ten reports per second
  let pointer = [], sent_at = 0, later = 0;
  const point = () => ((later = 0), (sent_at = performance.now()), api.tell("pointer", ...pointer));
  listen(window, "pointermove pointerout", (e) => {
    const canvas = window.__viserMutable?.canvas, box = canvas?.getBoundingClientRect();
    pointer = e.type === "pointermove" && canvas?.contains(e.target) && !e.buttons
      ? [e.clientX - (box.left + box.right) / 2, (box.top + box.bottom) / 2 - e.clientY] : [];
    later ||= setTimeout(point, Math.max(0, 100 - performance.now() + sent_at));
  }, { capture: true }); // viser's gizmos keep some events to themselves

  // ---- a double click resets the view
  listen(window, "dblclick", (e) => e.target.tagName === "CANVAS" && e.target !== strip && ask("look"));

  // ---- a first visit starts with the guide
  try {
    if (!localStorage.getItem("dbb-tour-seen")) ask("tour");
    localStorage.setItem("dbb-tour-seen", "yes");
  } catch {} // the browser has no storage

  const api = {
    ...window.dbbPanels,
    hints: (some) => (hints = some),
    head: (html) => (live_.innerHTML = html),
    card: (title, text, ...labels) => {
      card.replaceChildren();
      card.hidden = !title;
      make("h2", card, "", title);
      make("p", card, "", text);
      for (const label of labels) button(card, label, "", () => ask("card", label));
    },
    tell: (word, ...values) => {
      if (sent.get(word) === String(values)) return;
      sent.set(word, String(values));
      ask(word, ...values);
    },
    clear: (most, width) => {
      [kept, bin, rows] = [most, width, []];
      events.clear();
      hint.hidden = true;
      right = null;
      draw();
    },
    rows: (more) => {
      rows.push(...more);
      if (rows.length * bin > 1.1 * kept) rows.splice(0, rows.length - Math.round(kept / bin));
      draw();
    },
    events: (some) => {
      for (const e of some) events.set(e[0], e);
      const oldest = rows[0]?.[0] ?? 0;
      for (const [k, e] of events) if (e[1] < oldest - 1) events.delete(k);
      draw();
    },
    state: (...values) => {
      [now, at, begin, end, live, paused, d_b, playing, posing, earlier] = values;
      say();
    },
    // For tests: position of a time on the page, and the content of the timeline.
    pixel: (t) => [strip.getBoundingClientRect().left + x(t), strip.getBoundingClientRect().top + 25],
    seen: () => ({ from: from(), until: until(), now, at, rows, events: [...events.values()] }),
    end: () => {
      ending.abort();
      theme.disconnect();
      for (const element of [head, card, bar, edge, past, hint]) element.remove();
    },
  };
  return api;
};
