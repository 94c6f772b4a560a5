// A picture opens large, over the page, and closes at the next click or key.
addEventListener("DOMContentLoaded", () => {
  const dialog = document.createElement("dialog");
  const image = document.createElement("img");
  dialog.append(image);
  document.body.append(dialog);
  dialog.addEventListener("click", () => dialog.close());
  const open = (picture) => { image.src = picture.src; image.alt = picture.alt; dialog.showModal(); };
  document.querySelectorAll("img.large").forEach((picture) => {
    picture.addEventListener("click", () => open(picture));
    picture.addEventListener("keydown", (event) => { if (event.key === "Enter") open(picture); });
  });
});
