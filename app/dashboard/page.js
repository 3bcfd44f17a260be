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

  // [px] height of the scene, and how much of it the strip and the drawer of a narrow page lie over;
  // the strip grows and shrinks with what it says, under which the scene must not move.
  let tallest = 0;
  const scene = () => {
    const rect = (element) => element?.getBoundingClientRect() ?? { height: 0 };
    const box = rect(window.__viserMutable?.canvas);
    const [strip, drawer] = ["[data-strip]", "[data-drawer]"].map((kind) => rect(document.querySelector(kind)));
    tallest = matches(NARROW).matches ? Math.max(tallest, strip.height) : 0;
    const below = drawer.height && box.bottom - drawer.top;
    return [box.height, tallest, below].map((px) => Math.round(Math.max(px, 0)));
  };

  // What the page's address asks for is told once; the client may connect again and again.
  let asked = location.search.slice(1);
  window.dbbAsked = () => [asked, (asked = "")][0];
  const touch = () => {
    if (touched) return;
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
  const openPlace = () => {
    const drawer = document.querySelector("[data-drawer]");
    if (place === null || (!drawer && matches(NARROW).matches)) return;
    if (drawer) drawer.dataset.drawer = "open";
    const named = (tab) => tab.innerText.trim() === place;
    if (place) [...document.querySelectorAll("[role=tab]")].find(named)?.click();
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
      for (const kind of ["pointerdown", "keydown", "wheel"]) {
        window.addEventListener(kind, touch, true);
      }
      document.body.addEventListener("keydown", press);
      window.addEventListener("pointerdown", () => (byKeys = false), true);
      timer = setInterval(() => {
        makeHeads();
        openPlace();
        makeDrawer();
        thinOut();
        look();
      }, 300);
    },
  });
})();
