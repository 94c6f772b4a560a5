// What is wrong with the look of a page, as a list of sentences: overlaps, clipped text, sideways scrolling,
// contrast below WCAG AA, controls without a name or out of the keyboard's reach.
() => {
  const faults = [];
  const LEAST = 1.5;  // px by which boxes may overlap: rounding, and the spare space of letters
  const words = (element) => {
    const name = element.tagName.toLowerCase() + (element.id ? `#${element.id}` : "");
    const told = (element.value || element.textContent || element.getAttribute("aria-label") || "").trim();
    const place = element.closest("[data-path]")?.dataset.path;
    return `${name}.${String(element.getAttribute("class") || "").split(" ")[0]} "${told.slice(0, 40)}"${place ? ` of ${place}` : ""}`;
  };
  const read = (colour) => {
    const numbers = colour.match(/[\d.]+(e-?\d+)?/g)?.map(Number) ?? [0, 0, 0, 0];
    const scale = colour.startsWith("color(") ? 255 : 1;
    return [numbers[0] * scale, numbers[1] * scale, numbers[2] * scale, numbers[3] ?? 1];
  };
  const shown = (element) => element.checkVisibility({ opacityProperty: true, visibilityProperty: true });
  // The part of a box that its ancestors let be seen.
  const seen = (element, box) => {
    let [left, top, right, bottom] = [box.left, box.top, box.right, box.bottom];
    for (let node = element; node; node = node.parentElement) {
      const style = getComputedStyle(node);
      if (style.overflowX === "visible" && style.overflowY === "visible") continue;
      const around = node.getBoundingClientRect();
      if (style.overflowX !== "visible") { left = Math.max(left, around.left); right = Math.min(right, around.right); }
      if (style.overflowY !== "visible") { top = Math.max(top, around.top); bottom = Math.min(bottom, around.bottom); }
    }
    left = Math.max(left, 0); top = Math.max(top, 0);
    right = Math.min(right, innerWidth); bottom = Math.min(bottom, innerHeight);
    return right - left > 1 && bottom - top > 1 ? { left, top, right, bottom } : null;
  };
  const covered = (element, box) => {  // by a dialog, say
    const [x, y] = [(box.left + box.right) / 2, (box.top + box.bottom) / 2];
    const there = document.elementsFromPoint(x, y);
    const dialog = there[0]?.closest(".q-dialog, .q-notification, .q-menu, .q-tooltip");
    return Boolean(dialog && !dialog.contains(element));
  };

  // Text, by element: the boxes of its own letters.
  const texts = [];
  const all = [...document.body.querySelectorAll("*")].filter((element) => shown(element) && !element.closest("script, style, noscript"));
  for (const element of all) {
    const own = [...element.childNodes].filter((node) => node.nodeType === 3 && node.textContent.trim());
    const entry = element.matches("input:not([type=file]):not([type=checkbox]), textarea");
    if (!own.length && !(entry && (element.value || element.placeholder))) continue;
    const boxes = [];
    for (const node of own) {
      const range = document.createRange();
      range.selectNodeContents(node);
      boxes.push(...range.getClientRects());
    }
    if (entry) {  // a label of its own may stand in the padding
      const [box, style] = [element.getBoundingClientRect(), getComputedStyle(element)];
      const pads = ["Left", "Top", "Right", "Bottom"].map((side) => parseFloat(style[`padding${side}`]));
      const empty = !element.value && read(getComputedStyle(element, "::placeholder").color)[3] === 0;
      const [top, bottom] = [box.top + pads[1], box.bottom - pads[3]];
      // Of a line, its letters: the line itself is higher.
      const spare = element.matches("input") ? Math.max(0, (bottom - top - parseFloat(style.fontSize)) / 2) : 0;
      if (!empty) boxes.push({ left: box.left + pads[0], top: top + spare, right: box.right - pads[2], bottom: bottom - spare });
    }
    const parts = boxes.map((box) => seen(element, box)).filter((box) => box && !covered(element, box));
    if (parts.length) texts.push({ element, parts, entry });
  }
  for (let i = 0; i < texts.length; i += 1) {
    for (let j = i + 1; j < texts.length; j += 1) {
      const [a, b] = [texts[i], texts[j]];
      if (a.element.contains(b.element) || b.element.contains(a.element)) continue;
      if (a.parts.some((p) => b.parts.some((q) =>
        Math.min(p.right, q.right) - Math.max(p.left, q.left) > LEAST &&
        Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > LEAST))) {
        faults.push(`overlap: ${words(a.element)} and ${words(b.element)}`);
      }
    }
  }

  for (const { element, entry } of texts) {
    for (let node = element; node && node !== document.body; node = node.parentElement) {
      const style = getComputedStyle(node);
      const hides = /hidden|clip/.test(style.overflowX) || (entry && node === element);
      if (hides && node.clientWidth > 0 && node.scrollWidth > node.clientWidth + 1) faults.push(`clipped: ${words(element)} in ${words(node)}`);
      if (/auto|scroll/.test(style.overflowX)) break;
    }
  }

  if (document.documentElement.scrollWidth > innerWidth) faults.push(`sideways: the page is ${document.documentElement.scrollWidth} px wide`);
  for (const element of all) {
    if (/auto|scroll/.test(getComputedStyle(element).overflowX) && element.clientWidth > 0 && element.scrollWidth > element.clientWidth + 1) {
      faults.push(`sideways: ${words(element)}`);
    }
  }

  // Contrast, after the formulas of WCAG 2.
  const over = (front, back) => [0, 1, 2].map((i) => front[3] * front[i] + (1 - front[3]) * back[i]).concat(1);
  const light = ([r, g, b]) => {
    const [x, y, z] = [r, g, b].map((v) => (v / 255 <= 0.03928 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * x + 0.7152 * y + 0.0722 * z;
  };
  const ground = (element) => {
    const layers = [];
    for (let node = element; node; node = node.parentElement) {
      const colour = read(getComputedStyle(node).backgroundColor);
      if (colour[3] > 0) layers.push(colour);
      if (colour[3] === 1) break;
    }
    return layers.reverse().reduce((back, front) => over(front, back), [255, 255, 255, 1]);
  };
  for (const { element, entry } of texts) {
    if (element.closest("[disabled], .disabled, [aria-disabled=true]")) continue;
    const style = getComputedStyle(element, entry && !element.value ? "::placeholder" : null);
    const ink = read(element instanceof SVGElement ? style.fill : style.color);
    for (let node = element; node; node = node.parentElement) ink[3] *= Number(getComputedStyle(node).opacity);
    const back = ground(element);
    const [a, b] = [light(over(ink, back)), light(back)];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    const size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    if (ratio < (large ? 3 : 4.5)) faults.push(`contrast ${ratio.toFixed(2)}: ${words(element)}`);
  }

  // Controls.
  const CONTROLS = "button, input:not([type=hidden]):not([type=file]), select, textarea, a[href], summary, [role=button], [role=tab], [role=switch], [role=slider], [role=checkbox], [role=combobox], [role=radio], [role=link], [role=menuitem], [role=option], [tabindex='0']";
  const text = (element) => (element ? element.getAttribute("aria-label") || element.getAttribute("title") || element.textContent.trim() : "");
  const named = (element) => {
    const by = element.getAttribute("aria-labelledby");
    return (element.getAttribute("aria-label") || (by && by.split(" ").map((id) => text(document.getElementById(id))).join(" ").trim()) ||
      [...(element.labels ?? [])].map(text).join(" ").trim() || element.getAttribute("title") || element.getAttribute("placeholder") || element.getAttribute("alt") ||
      (element.matches("input, select, textarea") ? "" : element.textContent.trim()));
  };
  const dialog = document.querySelector(".q-dialog");
  const controls = all.filter((element) => element.matches(CONTROLS) && !element.closest("[disabled], .disabled, [aria-disabled=true]") && (!dialog || dialog.contains(element)));
  const reached = (element) => element.tabIndex >= 0 || Boolean(element.querySelector("input, button, [tabindex='0']"));
  const names = new Set(controls.filter((element) => element.tabIndex >= 0).map(named));
  for (const element of controls) {
    const name = named(element);
    if (!name && element.tabIndex >= 0) faults.push(`no name: ${words(element)}`);
    if (reached(element) || element.closest("[aria-hidden=true]")) continue;
    const group = element.closest("[role=tablist], [role=radiogroup]");  // arrows lead on within these
    const twin = names.has(name) || (group && (group.querySelector("[tabindex='0']") || group.contains(document.activeElement)));
    if (!twin && !element.parentElement?.closest("[tabindex='0'], button, a[href]")) faults.push(`not reached: ${words(element)}`);
  }
  for (const element of all) {  // what looks as if it could be clicked
    if (getComputedStyle(element).cursor !== "pointer" || getComputedStyle(element.parentElement).cursor === "pointer") continue;
    if (dialog && !dialog.contains(element)) continue;
    const near = element.closest(`${CONTROLS}, label`) || element.querySelector(CONTROLS) || element.closest(".q-field, .q-slider");
    if (!near && !element.closest("[disabled], .disabled, .js-plotly-plot")) faults.push(`not reached: ${words(element)} can be clicked`);
  }
  return [...new Set(faults)];
}
