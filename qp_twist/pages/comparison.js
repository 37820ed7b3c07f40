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
})();
