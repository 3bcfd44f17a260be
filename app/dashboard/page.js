// Runs in the page before viser's client does: what the server cannot see or say of a browser.
(() => {
  // How it draws goes into a cookie, which comes with the connection that the client opens next.
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info?.UNMASKED_RENDERER_WEBGL ?? gl?.RENDERER;
  const renderer = gl?.getParameter(name) ?? "";
  const software = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer);
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  document.cookie = `dbb-draws=${software ? "software" : "gpu"}; path=/; SameSite=Strict`;
  // viser's client would say so in a box that stays over the scene; the server tells it for a while.
  if (software) {
    const { getParameter } = WebGL2RenderingContext.prototype;
    WebGL2RenderingContext.prototype.getParameter = function (asked) {
      return asked === name ? "told" : getParameter.call(this, asked);
    };
  }

  // A tablet held upright has no room for panels beside the scene: it gets the phone's drawer.
  const matches = window.matchMedia.bind(window);
  const NARROW = "(max-width: 56em)";
  window.matchMedia = (query) => matches(query === "(max-width: 36em)" ? NARROW : query);

  // The drawer begins closed, and its first row opens it; viser's own way to close it would take
  // the strip away with it.
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

  // Who walks by Tab reaches folders too, and the space bar presses what he has come to, not the
  // page's own key.
  let byKeys = false;
  const HEADS = ".mantine-Paper-root > .mantine-Paper-root[style*='cursor: pointer']";
  const makeHeads = () => {
    for (const head of document.querySelectorAll(`${HEADS}:not([tabindex])`)) {
      head.tabIndex = 0;
      head.setAttribute("role", "button");
    }
  };
  // Names for screen readers: of icons by their picture, of sliders and boxes by the label beside them.
  const ICONS = { "list-search": "All commands", adjustments: "Display settings", x: "Close" };
  const makeNames = () => {
    document.getElementById("root")?.setAttribute("role", "main");
    for (const each of document.querySelectorAll("button:not([aria-label])")) {
      const icon = each.innerText.trim() ? null : each.querySelector("svg");
      const kind = icon && [...icon.classList].find((name) => name.startsWith("tabler-icon-"))?.slice(12);
      if (icon) each.setAttribute("aria-label", ICONS[kind] ?? kind?.replaceAll("-", " ") ?? "Close");
    }
    for (const each of document.querySelectorAll("[data-scrollarea-viewport]")) each.tabIndex = 0; // scrolls by keys
    for (const each of document.querySelectorAll("[role=slider][aria-label=''], .mantine-Input-input:not([aria-label])")) {
      let label = each.labels?.[0];
      for (let at = each.parentElement; at && !label; at = at.parentElement) label = at.querySelector("label");
      if (label) each.setAttribute("aria-label", label.textContent.replace("•", "").trim());
    }
  };
  const press = (event) => { // on its way to the page's own keys
    byKeys ||= event.key === "Tab";
    const [at, space] = [event.target, event.key === " "];
    if (!byKeys || !(space || event.key === "Enter")) return;
    const head = at.matches(HEADS);
    if (head || (space && at.matches("button, [role=button], [role=tab]"))) event.stopPropagation();
    if (!head) return;
    event.preventDefault();
    if (!event.repeat) at.click();
  };

  // The camera stays above the floor, wherever it looks to.
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

  // A light drawing has fewer pixels, unless the address says how many.
  let light = false;
  const thinOut = () => {
    if (location.search.includes("fixedDpr")) return;
    points.devSettings.set({ fixedDpr: light ? 0.7 * devicePixelRatio : null });
  };

  // What holds of the page is told as names: those of the marks in panels that are displayed,
  // "narrow", and "untouched" until anybody has touched it; a page of a test says so by itself.
  let touched = !!self.dbbTouched;
  const look = () => {
    const closed = document.querySelector("[data-drawer=closed]");
    const marks = [...document.querySelectorAll("[data-seen]")];
    const names = marks.filter((mark) => mark.getClientRects().length && !closed).map((mark) => mark.dataset.seen);
    if (matches(NARROW).matches) names.push("narrow");
    if (!touched) names.push("untouched");
    window.dbb?.tell("seen", names.join(" "));
    window.dbb?.tell("scene", ...scene());
  };

  const CARD = 150; // [px] of any card: the scene must not move with its text
  // [px] height of the scene, and how much of it the guide's card and the drawer of a narrow page cover.
  const scene = () => {
    const rect = (element) => element?.getBoundingClientRect() ?? { height: 0 };
    const [box, drawer] = [window.__viserMutable?.canvas, document.querySelector("[data-drawer]")].map(rect);
    const guided = document.getElementById("dbb-card")?.hidden === false ? CARD : 0;
    const [above, card] = matches(NARROW).matches ? [guided, 0] : [0, guided];
    const below = Math.max(card, drawer.height && box.bottom - drawer.top);
    return [box.height, above, below].map((px) => Math.round(Math.max(px, 0)));
  };

  // What the page's address asks for is told once; the client may connect again and again.
  let asked = location.search.slice(1);
  window.dbbAsked = () => [asked, (asked = "")][0];
  const touch = (event) => { // by a person, also through a screen reader; not by this script
    if (touched || !event.isTrusted) return;
    touched = true;
    look();
  };

  // What the server asks of the page: a light drawing, a title, and to open the panel with a name, or the
  // drawer alone for an empty one, since something stands there. A drawer may still be to come.
  let place = null;
  window.dbbPanels = {
    light: (on) => (light = on),
    open: (name) => (place = name),
    title: (text) => (document.title = text),
  };
  // Tabs of a dock answer to the pointer and to keys only, those of a panel to clicks only.
  const openTab = (tab) => {
    tab?.dispatchEvent(new KeyboardEvent("keydown", { key: "Enter", bubbles: true }));
    tab?.click();
  };
  const openPlace = () => {
    const drawer = document.querySelector("[data-drawer]");
    if (place === null || (!drawer && matches(NARROW).matches)) return;
    if (drawer) drawer.dataset.drawer = "open";
    const tab = [...document.querySelectorAll("[role=tab]")].find((each) => each.innerText.trim() === place);
    // A drawer shows the names of a closed group of tabs in one line, which opens it.
    const line = (each) => each.innerText.trim().split(" · ").includes(place);
    const group = drawer && place && !tab && [...drawer.querySelectorAll("div, span, p")].filter(line).pop();
    if (group) return group.click();
    openTab(tab);
    place = null;
  };

  // viser's client says when it is there; timers from before do not outlive its start.
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
      timer = setInterval(() => {
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
