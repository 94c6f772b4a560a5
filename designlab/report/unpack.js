// The plotting library is kept compressed: unpacked it is most of the page. Figures are drawn when it is there.
addEventListener("DOMContentLoaded", async () => {
  const run = (text) => {
    const script = document.createElement("script");
    script.textContent = text;
    document.head.append(script);
  };
  const packed = Uint8Array.from(atob("PACKED"), (each) => each.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  run(await new Response(stream).text());
  document.querySelectorAll('script[type="text/figure"]').forEach((figure) => run(figure.textContent));
});
