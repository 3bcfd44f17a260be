// Helpers inside the page. They use hooks of viser's client that are private, so viser is pinned.
(() => {
  // What draws in software here does so on purpose: without this a warning covers a part of the page.
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

  window.dbbPage = {
    viewer,
    canvas,
    node,
    ready: () => !!viewer()?.canvas && frame() > 0,
    has: (name) => !!node(name),
    // x of a frame that the server has put last: all that it sent before has arrived.
    arrived: (name) => viewer().nodePoseData[name]?.position?.[0],
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
  };
})();
