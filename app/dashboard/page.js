// Runs in the page before viser's client: reports the browser's state and adjusts viser's page.
(() => {
  // The cookie reports the renderer; the browser sends it when the client connects.
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info?.UNMASKED_RENDERER_WEBGL ?? gl?.RENDERER;
  const renderer = gl?.getParameter(name) ?? "";
  const software = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer);
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  document.cookie = `dbb-draws=${software ? "software" : "gpu"}; path=/; SameSite=Strict`;
  // viser's client would warn in a box that stays over the scene; instead the server shows a
  // notification.
  if (software) {
    const { getParameter } = WebGL2RenderingContext.prototype;
    WebGL2RenderingContext.prototype.getParameter = function (asked) {
      return asked === name ? "hidden" : getParameter.call(this, asked);
    };
  }

  // A cancelled file dialog, or a click while it is open, is not an error of the page.
  window.addEventListener("unhandledrejection", (event) => {
    const { name, message } = event.reason ?? {};
    if (name === "AbortError" || /File picker already active/.test(message)) event.preventDefault();
  });

  // viser's gizmo continues a drag that the browser has cancelled: here a cancel is an end. With
  // selected text, the browser would cancel a drag in order to move the text.
  window.addEventListener("dragstart", (event) => event.preventDefault());
  const last = new Map(); // the last event of each pressed pointer
  for (const kind of ["pointerdown", "pointermove", "pointerup"])
    window.addEventListener(kind, (event) => (event.buttons ? last.set(event.pointerId, event) : last.delete(event.pointerId)), true);
  window.addEventListener("pointercancel", ({ target, pointerId }) => {
    if (last.has(pointerId)) target.dispatchEvent(new PointerEvent("pointerup", last.get(pointerId)));
    last.delete(pointerId);
  }, true);

  // An upright tablet is too narrow for panels next to the scene: it gets the phone's drawer.
  const matches = window.matchMedia.bind(window);
  const NARROW = "(max-width: 56em)";
  window.matchMedia = (query) => matches(query === "(max-width: 36em)" ? NARROW : query);

  // The drawer starts closed, and a click on its first row opens or closes it. viser's own way to
  // close the drawer would hide this row too.
  const makeDrawer = () => {
    const drawer = document.querySelector(
      ".mantine-Paper-root[style*='position: fixed'][style*='bottom: 0']:not([data-drawer])",
    );
    if (!drawer) return;
    drawer.dataset.drawer = "closed";
    drawer.addEventListener("click", (event) => {
      const handle = drawer.querySelector(".mantine-ScrollArea-content > div > div");
      if (!handle?.contains(event.target) || event.target.closest("button")) return;
      event.stopPropagation();
      drawer.dataset.drawer = drawer.dataset.drawer === "open" ? "closed" : "open";
    }, true);
    drawer.addEventListener("focusin", ({ target }) => {
      if (byKeys && target.closest(".mantine-ScrollArea-content > div > div:nth-child(2)")) drawer.dataset.drawer = "open";
    });
  };

  // With Tab, the focus reaches folders too. The space bar then presses the focused element and
  // does not act as the page's key.
  let byKeys = false;
  const HEADS = ".mantine-Paper-root > .mantine-Paper-root[style*='cursor: pointer']";
  const makeHeads = () => {
    for (const head of document.querySelectorAll(`${HEADS}:not([tabindex])`)) {
      head.tabIndex = 0;
      head.setAttribute("role", "button");
    }
  };
  // Names for screen readers: from an icon's picture, and from the label of a slider or a box.
  const ICONS = { "list-search": "All commands", adjustments: "Display settings", x: "Close" };
  const makeNames = () => {
    document.getElementById("root")?.setAttribute("role", "main");
    for (const each of document.querySelectorAll("button:not([aria-label])")) {
      const icon = each.innerText.trim() ? null : each.querySelector("svg");
      const kind = icon && [...icon.classList].find((name) => name.startsWith("tabler-icon-"))?.slice(12);
      if (icon) each.setAttribute("aria-label", ICONS[kind] ?? kind?.replaceAll("-", " ") ?? "Close");
    }
    for (const each of document.querySelectorAll("[data-scrollarea-viewport]")) each.tabIndex = 0; // keys scroll it
    for (const each of document.querySelectorAll("[role=slider][aria-label=''], .mantine-Input-input:not([aria-label])")) {
      let label = each.labels?.[0];
      for (let at = each.parentElement; at && !label; at = at.parentElement) label = at.querySelector("label");
      if (label) each.setAttribute("aria-label", label.textContent.replace("•", "").trim());
    }
  };
  const press = (event) => { // before the page's own keys
    byKeys ||= event.key === "Tab";
    const [at, space] = [event.target, event.key === " "];
    if (!byKeys || !(space || event.key === "Enter")) return;
    const head = at.matches(HEADS);
    if (head || (space && at.matches("button, [role=button], [role=tab]"))) event.stopPropagation();
    if (!head) return;
    event.preventDefault();
    if (!event.repeat) at.click();
  };

  // The camera stays above the floor for every target.
  let guarded = null;
  const stayAbove = () => {
    const control = window.__viserMutable?.cameraControl;
    if (!control || control === guarded) return;
    guarded = control;
    const hold = () => {
      const most = Math.acos(Math.min(Math.max((0.05 - control.getTarget(control._target.clone()).y) / control.distance, -1), 1));
      control.maxPolarAngle = most;
      if (control.polarAngle > most + 1e-6) control.rotatePolarTo(most, false);
    };
    control.addEventListener("update", hold);
    hold();
  };

  // Low detail has fewer pixels, unless the address sets the number.
  let light = false;
  const thinOut = () => {
    if (location.search.includes("fixedDpr")) return;
    points.devSettings.set({ fixedDpr: light ? 0.7 * devicePixelRatio : null });
  };

  // The page's state is reported as names: those of the visible marks, and "untouched" before the
  // first input of a person. A test sets `dbbTouched` itself.
  let touched = !!self.dbbTouched;
  const look = () => {
    const closed = document.querySelector("[data-drawer=closed]");
    const marks = [...document.querySelectorAll("[data-seen]")];
    const names = marks.filter((mark) => mark.getClientRects().length && !closed).map((mark) => mark.dataset.seen);
    if (!touched) names.push("untouched");
    window.dbb?.tell("seen", names.join(" "));
    window.dbb?.tell("scene", ...scene());
  };

  // [px] least height to report for a card, and that of the highest card since the guide began: the
  // scene must not move with each text
  const CARD = 150;
  let tall = CARD;
  // [px] height of the scene, and the heights that card and drawer cover at its top and bottom.
  const scene = () => {
    const rect = (element) => element?.getBoundingClientRect() ?? { height: 0 };
    const [box, drawer] = [window.__viserMutable?.canvas, document.querySelector("[data-drawer]")].map(rect);
    const guide = rect(document.getElementById("dbb-card"));
    tall = guide.height ? Math.max(tall, guide.height) : CARD;
    const beside = guide.left > (box.left + box.right) / 2;
    const guided = guide.height && !beside ? tall : 0;
    document.documentElement.style.setProperty("--dbb-card", `${guided}px`);
    const [above, card] = matches(NARROW).matches ? [guided, 0] : [0, guided];
    const below = Math.max(card, drawer.height && box.bottom - drawer.top);
    return [box.height, above, below].map((px) => Math.round(Math.max(px, 0)));
  };

  const touch = (event) => { // input of a person, also with a screen reader; not of this script
    if (touched || !event.isTrusted) return;
    touched = true;
    look();
  };

  // Requests of the server: low detail, a title, or a panel to open by its name. With an empty name
  // only the drawer opens. The drawer may not exist yet.
  let place = null;
  window.dbbPanels = {
    light: (on) => (light = on),
    open: (name) => (place = name),
    title: (text) => (document.title = text),
  };
  // Tabs of a dock react to the pointer and to keys only, and tabs of a panel to clicks only.
  const openTab = (tab) => {
    tab?.dispatchEvent(new KeyboardEvent("keydown", { key: "Enter", bubbles: true }));
    tab?.click();
  };
  const openPlace = () => {
    const drawer = document.querySelector("[data-drawer]");
    if (place === null || (!drawer && matches(NARROW).matches)) return;
    if (drawer) drawer.dataset.drawer = "open";
    const tab = [...document.querySelectorAll("[role=tab]")].find((each) => each.innerText.trim() === place);
    // A drawer shows the names of a closed group of tabs in one line, which opens the group.
    const line = (each) => each.innerText.trim().split(" · ").includes(place);
    const group = drawer && place && !tab && [...drawer.querySelectorAll("div, span, p")].filter(line).pop();
    if (group) return group.click();
    openTab(tab);
    place = null;
  };

  // If a proxy does not connect the page to its server, the page shows a remedy.
  let unconnected = 0; // number of the timer's periods without a connection
  const explain = () => {
    const waits = !window.dbb && document.getElementById("root")?.innerText.includes("Connecting...");
    unconnected = waits ? unconnected + 1 : 0;
    if (!waits) document.getElementById("dbb-unconnected")?.remove();
    if (unconnected !== 30) return;
    const box = document.createElement("p");
    Object.assign(box, { id: "dbb-unconnected", role: "alert" });
    box.textContent = "No connection to the server. A proxy in between must forward websockets. If it changes the " +
      `requested name, the server needs the option --allow-host ${location.hostname}.`;
    document.body.append(box);
  };

  // viser's client sets this property when it starts; earlier timers do not survive its start.
  let points, timer;
  Object.defineProperty(window, "__viserTestpoints", {
    configurable: true,
    get: () => points,
    set: (value) => {
      points = value;
      if (timer) return;
      for (const kind of ["pointerdown", "click", "keydown", "wheel"]) {
        window.addEventListener(kind, touch, true);
      }
      document.body.addEventListener("keydown", press);
      window.addEventListener("pointerdown", () => (byKeys = false), true);
      // After a drawer, viser's panel has its default width; the server sets its own again.
      matches(NARROW).addEventListener("change", ({ matches }) => matches || window.dbb?.tell("wide", Date.now()));
      timer = setInterval(() => {
        explain();
        makeHeads();
        makeNames();
        openPlace();
        makeDrawer();
        thinOut();
        stayAbove();
        look();
      }, 300);
    },
  });
})();
