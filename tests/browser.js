// Helpers inside the page. They use hooks of viser's client that are private, so viser is pinned.
(() => {
  // Tests draw in software on purpose: without this a warning about it covers a part of the page.
  for (const kind of [self.WebGLRenderingContext, self.WebGL2RenderingContext]) {
    if (!kind) continue;
    const original = kind.prototype.getParameter;
    const UNMASKED_RENDERER = 37446;
    kind.prototype.getParameter = function (name) {
      const value = original.call(this, name);
      return name === UNMASKED_RENDERER && typeof value === "string" ? "headless" : value;
    };
  }

  const viewer = () => window.__viserMutable;
  const frame = () => window.__viserTestpoints?.rendererInfo?.render?.frame ?? -1;
  const canvas = () => {
    const element = viewer().canvas;
    return element.tagName === "CANVAS" ? element : element.querySelector("canvas");
  };
  const node = (name) => viewer().nodeRefFromName[name];
  const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

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
    ready: () => !!viewer()?.canvas && frame() > 0,
    node: (name) => !!node(name),
    pixel,
    // In the scene's frame, z up; three.js itself has y up.
    position: (name) => node("").worldToLocal(world(name, [0, 0, 0])).toArray(),
    box: () => {
      const b = canvas().getBoundingClientRect();
      return [b.left, b.top, b.right, b.bottom].map(Math.round);
    },
    // Reading a pixel back waits for the drawing, which software renderers do later.
    render: async (count) => {
      const last = frame() + count;
      while (frame() < last) {
        viewer().requestRender();
        await pause(15);
      }
      const gl = canvas().getContext("webgl2");
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    },
    // A point on an arrow of a gizmo where that arrow really lies on top, or null.
    arrow: (name, axis, scale) => {
      for (const share of [0.95, 0.9, 0.85, 0.8, 0.7, 0.5, 0.4]) {
        const point = [0, 0, 0];
        point[axis] = share * scale;
        const found = hit(name, pixel(name, point));
        if (!found || found.shape !== "CylinderGeometry") continue;
        const [j, k] = [(axis + 1) % 3, (axis + 2) % 3];
        if (Math.hypot(found.local[j], found.local[k]) < 0.12 * scale) return point;
      }
      return null;
    },
  };
})();
