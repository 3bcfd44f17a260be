// Runs in the page before viser's client does: what the server cannot see or say of a browser.
(() => {
  // How it draws goes into a cookie, which comes with the connection that the client opens next.
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const renderer = gl?.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER) ?? "";
  const software = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer);
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  document.cookie = `dbb-draws=${software ? "software" : "gpu"}; path=/; SameSite=Strict`;

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
  };

  // A light drawing has fewer pixels, unless the address says how many.
  const thinOut = () => {
    if (location.search.includes("fixedDpr")) return;
    const light = document.querySelector("[data-light]");
    points.devSettings.set({ fixedDpr: light ? 0.7 * devicePixelRatio : null });
  };

  // What is to be seen: a mark in a panel names a box that is on while the mark is displayed.
  const told = new Map();
  const tell = (uuid, seen) => {
    if (told.get(uuid) === seen) return;
    told.set(uuid, seen);
    const message = { type: "GuiUpdateMessage", uuid, updates: { value: seen } };
    window.__viserMutable?.sendMessage(message);
  };
  const look = () => {
    const closed = document.querySelector("[data-drawer=closed]");
    const seen = new Set();
    for (const mark of document.querySelectorAll("[data-seen]")) {
      if (mark.getClientRects().length && !closed) seen.add(mark.dataset.seen);
    }
    const untouched = document.querySelector("[data-untouched]");
    if (untouched && !touched) seen.add(untouched.dataset.untouched);
    for (const uuid of told.keys()) if (!seen.has(uuid)) tell(uuid, false);
    for (const uuid of seen) tell(uuid, true);
  };

  // Whether anybody has touched the page; a page of a test says so by itself.
  let touched = !!self.dbbTouched;
  const touch = () => {
    if (touched) return;
    touched = true;
    look();
  };

  // A step of the tour stands in a panel, which has to be open for it.
  let opened = null;
  const openForTour = () => {
    const place = document.querySelector("[data-tour]")?.dataset.tour ?? null;
    if (place === opened) return;
    opened = place;
    const drawer = document.querySelector("[data-drawer]");
    if (drawer && place !== null) drawer.dataset.drawer = "open";
    if (!place) return;
    const named = (tab) => tab.innerText.trim() === place;
    [...document.querySelectorAll("[role=tab]")].find(named)?.click();
  };

  // viser's client says when it is there; timers from before do not outlive its start.
  let points, timer;
  Object.defineProperty(window, "__viserTestpoints", {
    configurable: true,
    get: () => points,
    set: (value) => {
      points = value;
      if (timer) return;
      for (const kind of ["pointerdown", "keydown", "wheel"]) {
        window.addEventListener(kind, touch, true);
      }
      timer = setInterval(() => {
        openForTour();
        makeDrawer();
        thinOut();
        look();
      }, 300);
    },
  });
})();
