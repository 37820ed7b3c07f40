"use strict";
(() => {
  // The scene: the player with a method's recording put into its head. It is there only while it is
  // near the window: without a graphics card it slows down the whole page.
  const recordings = {};
  for (const element of document.querySelectorAll("script.recording")) {
    recordings[element.dataset.method] = element.textContent;
  }
  let playing = false;
  const views = [...document.querySelectorAll(".view")];
  const player = () => JSON.parse(document.getElementById("player").textContent);
  // As the page itself: dark where the reader prefers it and the page has such colours.
  const scheme = document.querySelector("meta[name=color-scheme]").content;
  const dark = scheme.includes("dark") && matchMedia("(prefers-color-scheme: dark)").matches;
  const play = () => {
    playing = true;
    const page = player();
    const head = page.indexOf("</head>");
    for (const view of views) {
      const data = recordings[view.querySelector("select")?.value ?? view.dataset.method];
      const frame = view.querySelector("iframe");
      if (frame) frame.srcdoc = page.slice(0, head) +
        "<script>window.__VISER_EMBED_DATA__=\"" + data + "\";" +
        "window.__VISER_EMBED_CONFIG__={darkMode:" + dark + "};</" + "script>" + page.slice(head);
    }
  };
  const stop = () => {
    playing = false;
    for (const view of views) view.querySelector("iframe")?.removeAttribute("srcdoc");
  };
  const watched = document.querySelector(".views");
  if (watched) {
    new IntersectionObserver((entries) => {
      const near = entries.at(-1).isIntersecting;
      if (near !== playing) (near ? play : stop)();
    }, { rootMargin: "300px" }).observe(watched);
  }
  for (const view of views) view.querySelector("select")?.addEventListener("change", play);
})();
