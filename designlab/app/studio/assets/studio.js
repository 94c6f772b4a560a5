// The picture of the studio: shows what the server sends, never an older one, and tells where it is touched.
(() => {
  const shown = {};  // newest picture of each slot
  let expected = { digest: "", request: 0 };
  const element = (id) => document.getElementById(id);

  const draw = () => {
    for (const slot of ["now", "pinned"]) {
      const image = element(`picture-${slot}`);
      if (!image) continue;
      const picture = shown[slot];
      image.hidden = !picture;
      if (!picture) continue;
      if (image.src !== picture.src) image.src = picture.src;
      image.dataset.digest = picture.digest;
      image.dataset.request = picture.request;
      image.dataset.step = picture.step;
      image.alt = picture.alt;
      if (slot === "now") {
        const stale = picture.digest !== expected.digest;
        element("stage").classList.toggle("stale", stale);
        const coming = expected.failed ? "of this one there is no picture" : "the new picture is on its way";
        element("caption").textContent = stale ? `previous design; ${coming}` : picture.caption;
        element("facts").textContent = picture.facts;
        element("stage").style.setProperty("--shape", picture.shape);
      }
    }
    const both = Boolean(shown.pinned);
    element("stage")?.classList.toggle("both", both);
    const relief = shown.relief;
    const old = relief && (relief.digest !== expected.digest || relief.request < expected.request);
    document.querySelector(".maps")?.classList.toggle("stale", Boolean(old));
    mark();
  };

  const mark = (place) => {
    const ring = element("probe-mark");
    if (!ring) return;
    if (place) ring.dataset.place = JSON.stringify(place);
    const at = ring.dataset.place ? JSON.parse(ring.dataset.place) : null;
    ring.hidden = !at || element("stage").dataset.mode !== "pressed";
    if (!at) return;
    ring.style.left = `${100 * at[0]}%`;
    ring.style.top = `${100 * at[1]}%`;
    ring.style.width = `${100 * at[2]}%`;
  };

  let waiting = null;
  const tell = (place, going_on) => {
    const first = waiting === null;
    waiting = { place, going_on };
    if (first) requestAnimationFrame(() => { emitEvent("studio_touch", waiting); waiting = null; });
  };

  const touchable = () => {
    const area = element("pictures");
    if (!area || area.dataset.ready) return;
    area.dataset.ready = "1";
    const place = (event) => {
      const box = area.getBoundingClientRect();
      return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height]
        .map((share) => Math.min(1, Math.max(0, share)));
    };
    const move = (event, going_on) => {
      const at = place(event);
      const ring = element("probe-mark");
      const size = ring.dataset.place ? JSON.parse(ring.dataset.place)[2] : 0.1;
      mark([...at, size]);
      tell(at, going_on);
    };
    area.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      area.setPointerCapture(event.pointerId);
      area.dataset.held = "1";
      move(event, true);
    });
    area.addEventListener("pointermove", (event) => { if (area.dataset.held) move(event, true); });
    const release = (event) => {
      if (!area.dataset.held) return;
      delete area.dataset.held;
      move(event, false);
    };
    area.addEventListener("pointerup", release);
    area.addEventListener("pointercancel", release);
    area.addEventListener("wheel", (event) => {
      event.preventDefault();
      emitEvent("studio_push", { steps: event.deltaY < 0 ? 1 : -1 });
    }, { passive: false });
    area.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (steps) {
        event.preventDefault();
        emitEvent("studio_nudge", { steps, large: event.shiftKey });
      } else if (event.key === "+" || event.key === "=" || event.key === "-") {
        event.preventDefault();
        emitEvent("studio_push", { steps: event.key === "-" ? -1 : 1 });
      }
    });
  };

  // The part of a slider that the keyboard reaches has no name of its own.
  const nameSliders = () => {
    for (const slider of document.querySelectorAll(".q-slider[aria-label]")) {
      slider.querySelector("[tabindex]")?.setAttribute("aria-label", slider.getAttribute("aria-label"));
    }
  };
  new MutationObserver(nameSliders).observe(document, { subtree: true, childList: true });

  window.studio = {
    // What the next picture must belong to; older ones are marked as such.
    expect(digest, request) {
      expected = { digest, request };
      element("stage").dataset.expected = digest;
      draw();
    },
    show(slot, picture) {
      if (slot === "now" && picture.digest !== expected.digest) return;
      const before = shown[slot];
      if (before && before.request > picture.request) return;
      shown[slot] = picture;
      draw();
      window.dispatchEvent(new CustomEvent("studio-picture", { detail: { slot, request: picture.request, step: picture.step } }));
    },
    // Of what is expected there will be no picture.
    fail(digest) { if (digest === expected.digest) { expected.failed = true; draw(); } },
    // What the maps were read off.
    relief(digest, request) { shown.relief = { digest, request }; draw(); },
    forget(slot) { delete shown[slot]; draw(); },
    mark,
    mode(name) { element("stage").dataset.mode = name; draw(); },
    wipe(share) { element("stage").style.setProperty("--wipe", `${share}%`); },
    map(id, source, alt) {
      const image = element(id);
      if (!image) return;
      image.src = source;
      image.alt = alt;
      image.hidden = false;
    },
    // Draw a scene where it is seen and something in it has moved: without a graphics card each frame costs.
    calm(id) {
      const place = element(id);
      const view = window.getElement(Number(id.slice(1)));
      if (!view?.renderer) { if (place) setTimeout(() => studio.calm(id), 200); return; }
      if (view.renderer.studioCalm) return;
      view.renderer.studioCalm = true;
      const render = view.renderer.render.bind(view.renderer);
      let [before, still] = ["", 0];
      view.renderer.render = (scene, camera) => {
        if (!place.checkVisibility()) { before = ""; return; }
        let parts = 0;
        scene.traverse(() => { parts += 1; });
        const now = [...camera.position, ...camera.quaternion.toArray(), parts].map((x) => x.toFixed(5)).join();
        still = now === before ? still + 1 : 0;
        before = now;
        if (still < 20) render(scene, camera);  // a second more, in which materials come
      };
    },
    words(id, text) { if (element(id)) element(id).textContent = text; },
    begin() { touchable(); draw(); },
  };
})();
