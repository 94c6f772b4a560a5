const plot = document.getElementById("{plot_id}"), figure = plot.closest("figure");
const image = figure.querySelector("img.pointed");
const pictures = JSON.parse(figure.querySelector('script[type="application/json"]').textContent);
plot.on("plotly_hover", (event) => {
  const found = pictures[event.points[0].customdata];
  if (found) { image.src = found; image.hidden = false; }
});
plot.on("plotly_unhover", () => { image.hidden = true; });
