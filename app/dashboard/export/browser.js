// Helpers inside the page. viser's version is fixed, because they use private hooks of its client.
(() => {
  // Software rendering is intended here: without this change, a warning covers a part of the page.
  // With this change, the server assumes a GPU and sends full detail.
  for (const kind of [self.WebGLRenderingContext, self.WebGL2RenderingContext]) {
    if (!kind || self.dbbHonest) continue;
    const original = kind.prototype.getParameter;
    const UNMASKED_RENDERER = 37446;
    kind.prototype.getParameter = function (name) {
      const value = original.call(this, name);
      return name === UNMASKED_RENDERER && typeof value === "string" ? "headless" : value;
    };
  }

  // While `held` is true, the page does everything except drawing, so that messages cost no frame.
  let held = false;
  for (const kind of [self.WebGL2RenderingContext?.prototype]) {
    for (const name of ["clear", "drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
      const original = kind?.[name];
      if (original) kind[name] = function (...args) { if (!held) original.apply(this, args); };
    }
  }

  const viewer = () => window.__viserMutable;
  const frame = () => window.__viserTestpoints?.rendererInfo?.render?.frame ?? -1;
  const canvas = () => {
    const element = viewer().canvas;
    return element.tagName === "CANVAS" ? element : element.querySelector("canvas");
  };
  const node = (name) => viewer().nodeRefFromName[name];
  const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

  // Checks every `ms` milliseconds, with a timeout for a page that has crashed.
  const until = async (there, ms) => {
    const deadline = performance.now() + 60_000;
    while (!there()) {
      if (performance.now() > deadline) throw new Error("the page has drawn nothing for a minute");
      await pause(ms);
    }
  };
  const render = async (count) => {
    const last = frame() + count;
    await until(() => frame() >= last || void viewer().requestRender(), held ? 4 : 15);
  };
  let flat = null;

  window.dbbPage = {
    viewer,
    canvas,
    node,
    ready: () => !!viewer()?.canvas && frame() > 0,
    has: (name) => !!node(name),
    hold: (on) => { held = on; },
    // x of a scene node: the last number of `send_barrier`, which follows all earlier messages.
    arrived: (name) => viewer().nodePoseData[name]?.position?.[0],
    // Reading back a pixel waits until the drawing is complete; software renderers delay it.
    render: async (count) => {
      await render(count);
      const gl = canvas().getContext("webgl2");
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    },
    // One picture of a film as a base64 JPEG. It is drawn exactly once, after all messages have
    // arrived: waiting for a frame of the browser could draw two.
    // Eye and target are in the scene's frame with z up; three.js has y up.
    still: async ([name, n, eye, target, ground]) => {
      held = flat !== null; // the first frame is drawn too, because it fills the textures of reflections
      await until(() => dbbPage.arrived(name) === n, 2);
      const inWorld = ([x, y, z]) =>
        node("").localToWorld(viewer().camera.position.clone().set(x, y, z)).toArray();
      viewer().cameraControl.setLookAt(...inWorld(eye), ...inWorld(target), false);
      await render(2);
      held = false;
      node("").__r3f.root.getState().advance(performance.now());
      held = true;
      const { width, height } = canvas();
      flat ??= new OffscreenCanvas(width, height);
      const ink = flat.getContext("2d", { willReadFrequently: true });
      ink.fillStyle = ground;
      ink.fillRect(0, 0, width, height);
      ink.drawImage(canvas(), 0, 0);
      const blob = await flat.convertToBlob({ type: "image/jpeg", quality: 0.95 });
      const reader = new FileReader();
      await new Promise((done) => ((reader.onload = done), reader.readAsDataURL(blob)));
      return reader.result.split(",")[1];
    },
  };
})();
