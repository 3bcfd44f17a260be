// More helpers inside the page, for tests; those of app/dashboard/browser.js come first.
(() => {
  const { viewer, canvas, node } = window.dbbPage;

  // Drawing in software takes nine tenths of the time. So the page draws only once the scene is
  // there, and a picture when a test looks; in between the canvas keeps what it shows.
  let drawing = false;
  const draws = ["clear", "drawArrays", "drawElements", "drawRangeElements",
    "drawArraysInstanced", "drawElementsInstanced"];
  for (const name of draws) {
    const original = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...args) {
      if (drawing) original.apply(this, args);
    };
  }
  // Nor has it to do all the rest sixty times a second then.
  const soon = window.requestAnimationFrame.bind(window);
  const never = window.cancelAnimationFrame.bind(window);
  window.requestAnimationFrame = (callback) =>
    drawing ? soon(callback) : -setTimeout(() => callback(performance.now()), 50);
  window.cancelAnimationFrame = (id) => (id < 0 ? clearTimeout(-id) : never(id));

  const world = (name, point) => {
    const object = node(name);
    object.updateWorldMatrix(true, false);
    return object.localToWorld(object.position.clone().set(...point));
  };

  const pixel = (name, point) => {
    const camera = viewer().camera;
    camera.updateMatrixWorld();
    const p = world(name, point).project(camera);
    const box = canvas().getBoundingClientRect();
    return [box.left + ((p.x + 1) / 2) * box.width, box.top + ((1 - p.y) / 2) * box.height];
  };

  // Whether the mouse reaches the scene there: panels and their edges lie over it.
  const free = ([x, y]) => !!document.elementFromPoint(x, y)?.contains(canvas());

  // The first thing of a gizmo under a pixel, in the gizmo's frame, by the page's own ray caster.
  const hit = (name, at) => {
    const object = node(name);
    const state = object.__r3f.root.getState();
    const box = canvas().getBoundingClientRect();
    const pointer = {
      x: ((at[0] - box.left) / box.width) * 2 - 1,
      y: 1 - ((at[1] - box.top) / box.height) * 2,
    };
    state.raycaster.setFromCamera(pointer, state.camera);
    const gizmo = object.parent.parent;
    const [first] = state.raycaster.intersectObject(gizmo, true);
    if (!first) return null;
    const local = object.worldToLocal(first.point.clone()).toArray();
    return { shape: first.object.geometry.type, local };
  };

  window.dbbTest = {
    draw: (on) => (drawing = on),
    pixel,
    pixels: (name, points) => points.map((point) => pixel(name, point)),
    // In the scene's frame, z up; three.js itself has y up.
    place: (name, point) => node("").worldToLocal(world(name, point)).toArray(),
    position: (name) => dbbTest.place(name, [0, 0, 0]),
    // Times, lines and cursor of a plot.
    plot: (title) => {
      for (const { chart } of Object.values(window.__viserTestpoints.uplots ?? {})) {
        const name = chart.root.querySelector(".u-title")?.textContent;
        if (name === title) return chart.data.map((line) => Array.from(line));
      }
      return null;
    },
    // Eye in the scene's frame.
    camera: () => {
      const { camera } = viewer();
      camera.updateMatrixWorld();
      const eye = camera.position.clone().setFromMatrixPosition(camera.matrixWorld);
      return node("").worldToLocal(eye).toArray();
    },
    shown: (name) => !!window.__viserSceneTree.getState()[name]?.effectiveVisibility,
    text: (name) => window.__viserSceneTree.getState()[name]?.message?.props?.text ?? null,
    // Of what floats over the scene.
    windows: () =>
      [...document.querySelectorAll("[data-floating-window]")].map((element) => {
        const b = element.getBoundingClientRect();
        return [b.left, b.top, b.right, b.bottom].map(Math.round);
      }),
    box: () => {
      const b = canvas().getBoundingClientRect();
      return [b.left, b.top, b.right, b.bottom].map(Math.round);
    },
    // A point on an arrow of a gizmo where that arrow really lies on top of all, or null.
    arrow: (name, axis, scale) => {
      for (const share of [0.95, 0.9, 0.85, 0.8, 0.7, 0.5, 0.4]) {
        const point = [0, 0, 0];
        point[axis] = share * scale;
        const at = pixel(name, point);
        const found = free(at) && hit(name, at);
        if (!found || found.shape !== "CylinderGeometry") continue;
        const [j, k] = [(axis + 1) % 3, (axis + 2) % 3];
        if (Math.hypot(found.local[j], found.local[k]) < 0.12 * scale) return point;
      }
      return null;
    },
  };
})();
