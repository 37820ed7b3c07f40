"use strict";
(() => {
  // The methods in the figures: a class on main hides the curves of a method that is not chosen.
  const main = document.getElementById("main");
  const boxes = [...document.querySelectorAll("#selector input")];
  const update = () => {
    main.classList.add("chosen");
    for (const box of boxes) main.classList.toggle("without-" + box.value, !box.checked);
  };
  const presets = {
    all: () => true,
    closed: (box) => box.dataset.kind === "closed",
    qp: (box) => box.dataset.kind === "qp",
    first: (box) => box.dataset.first === "yes",
  };
  for (const box of boxes) box.addEventListener("change", update);
  for (const button of document.querySelectorAll("[data-preset]")) {
    button.addEventListener("click", () => {
      for (const box of boxes) box.checked = presets[button.dataset.preset](box);
      update();
    });
  }

  // On a phone a figure is as wide as the page until it is tapped: page.css has the two widths.
  for (const drawing of document.querySelectorAll(".drawing")) {
    drawing.addEventListener("click", () => drawing.classList.toggle("large"));
  }

  // The scene: the player with a method's recording put into its head. It is there only while it is
  // near the window: without a graphics card it slows down the whole page.
  const recordings = {};
  for (const element of document.querySelectorAll("script.recording")) {
    recordings[element.dataset.method] = element.textContent;
  }
  let playing = false;
  const views = [...document.querySelectorAll(".view")];
  const player = () => JSON.parse(document.getElementById("player").textContent);
  const play = () => {
    playing = true;
    const page = player();
    const head = page.indexOf("</head>");
    for (const view of views) {
      const data = recordings[view.querySelector("select").value];
      const frame = view.querySelector("iframe");
      if (frame) frame.srcdoc = page.slice(0, head) +
        "<script>window.__VISER_EMBED_DATA__=\"" + data + "\";" +
        "window.__VISER_EMBED_CONFIG__={darkMode:false};</" + "script>" + page.slice(head);
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
  for (const view of views) view.querySelector("select").addEventListener("change", play);
})();
