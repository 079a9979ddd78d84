// Live figures are pages of their own: they are given the colours of this page, and as much height as they need.
addEventListener("DOMContentLoaded", () => {
  const figures = [...document.querySelectorAll("iframe.live-figure")];
  if (!figures.length) return;
  const colour = (figure) => figure.contentWindow.postMessage({ lmpchainTheme: document.body.dataset.theme || "auto" }, "*");
  addEventListener("message", (event) => {
    const figure = figures.find((one) => one.contentWindow === event.source);
    if (!figure || !event.data || !(event.data.lmpchainHeight > 0)) return;
    figure.style.height = `${Math.ceil(event.data.lmpchainHeight) + 2}px`;
    colour(figure);
  });
  new MutationObserver(() => figures.forEach(colour)).observe(document.body, { attributeFilter: ["data-theme"] });
});
